"""The rooms of a building's run, as its folder keeps them."""

from __future__ import annotations

from conf import Config, ConfigError
from conf.rooms import Room, from_json, rooms_of, to_json
from env.texts import read_text
from storage.atomic import write_atomically
from training.run_folder import RunFolder


def known_rooms(config: Config, folder: RunFolder) -> list[Room]:
    """A building's rooms: as its folder says, or drawn and written there.

    Raises:
        ConfigError: see ``conf.rooms.rooms_of``.
    """
    path = folder.rooms_file
    if path.is_file():
        try:
            rooms = from_json(read_text(path))
        except (OSError, ValueError) as error:
            raise ConfigError(f"{path} cannot be read: {error}.") from error
        own = [(False, index) for index in range(config.rooms.count)]
        own += [(True, index) for index in range(config.rooms.held_out)]
        if [(room.held_out, room.index) for room in rooms] != own:
            raise ConfigError(f"{path}: its rooms are not those of the run's configuration.")
        return rooms
    rooms = rooms_of(config, check=False)  # as was done before the run began
    write_atomically(path, to_json(rooms))
    return rooms
