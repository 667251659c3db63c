"""What a run says before it starts: nothing is wrong, but it may not be what was meant."""

from __future__ import annotations

from conf import Config
from env.mdp import lateness
from env.radio import mounting
from env.scenario import Scenario


def notices(config: Config) -> list[str]:
    """What is worth a look in a checked configuration, a sentence each; most have nothing."""
    scenario = Scenario.drawn(config.env, config.seed)
    return [*_late(scenario), *_unseen(scenario), *_outside(scenario)]


def _late(scenario: Scenario) -> list[str]:
    """The starts from which no robot can arrive."""
    config = scenario.config
    share = lateness.late_share(config, scenario.destinations)
    if not share:
        return []
    shown = "under 1" if share < 0.01 else f"{100 * share:.0f}"
    say = "of the starts are more slots away from their destination"
    slots = f"{lateness.KEY}={config.motion.max_slots}"
    return [f"{slots}: {shown} % {say}, and no robot arrives from there."]


def _unseen(scenario: Scenario) -> list[str]:
    """An AP or an RIS behind walls from everything."""
    config, floor = scenario.config, scenario.floor
    reached = floor.centres()[floor.drivable()]
    ap, ris, found = config.ap.position_m, config.ris.position_m, []
    devices = [("env.ap", "the AP", ap), ("env.ris", "the RIS", ris)][: 2 if config.ris.side else 1]
    for key, name, position in devices:
        if not mounting.sees(floor, position, reached).any():
            say = f"no cell that robots reach is in {name}'s line of sight"
            found.append(f"{key}.position_m={position}: {say}.")
    if len(devices) == 2 and not mounting.see_each_other(floor, ris, ap).all():
        found.append(f"env.ris.position_m={ris}: the AP is not in the RIS's line of sight.")
    return found


def _outside(scenario: Scenario) -> list[str]:
    """Walls beyond the room, which do nothing."""
    size_m, ends = scenario.floor.size_m, scenario.floor.walls.reshape(-1, 2, 2)
    beyond = ((ends < 0).all(axis=1) | (ends > size_m).all(axis=1)).any(axis=-1)
    if not beyond.any():
        return []
    room = f"the room of {size_m[0]:g} m x {size_m[1]:g} m"
    number = f"{beyond.sum()} of {len(ends)}"
    return [f"env.walls.segments: {number} lie outside of {room} and do nothing."]
