"""Traces a room's channels with Sionna RT and writes them as a file (docs/channels.md).

python docs/examples/sionna_channels.py traced.npz env.ris.subsurfaces=4
risfleet train env.channel.model=file env.channel.file=traced.npz env.ris.subsurfaces=4
"""

import argparse
from typing import NamedTuple

import numpy as np
import sionna.rt as rt
from mitsuba import Mesh, traverse

from conf import compose
from env.geometry.floor import Floor
from env.radio.channel_file import write_channels
from env.radio.mounting import inner_walls
from env.radio.propagation import element_offsets_m, wavelength_m

HEIGHT_M = 3.0
OFF_WALL_M = 0.05
"""How far devices hang from the room's edge, which is a wall here."""

SILENT = 1e-10
"""The channel of a cell that no path reaches, -200 dB: a file's direct is nowhere zero."""


class Paths(NamedTuple):
    """P paths from one place to each of Q points, padded with gains of zero."""

    gain: np.ndarray  # complex, with the phase of the way, (Q, P)
    leaves: np.ndarray  # unit vectors in which they leave, (Q, P, 3)
    arrives: np.ndarray  # unit vectors that point back along them from where they arrive, (Q, P, 3)


def build_scene(config, free_space=False):
    """Outer and inner walls, floor and ceiling of concrete; or nothing at all."""
    scene = rt.load_scene()
    scene.frequency = config.channel.frequency_ghz * 1e9
    scene.tx_array = scene.rx_array = rt.PlanarArray(
        num_rows=1, num_cols=1, vertical_spacing=0.5, horizontal_spacing=0.5,
        pattern="iso", polarization="V",
    )  # fmt: skip
    if free_space:
        return scene
    width, depth, top = config.room.width_m, config.room.depth_m, HEIGHT_M
    edges = [[0, 0, width, 0], [width, 0, width, depth], [width, depth, 0, depth], [0, depth, 0, 0]]
    walls = [*edges, *inner_walls(Floor.from_config(config)).tolist()]
    faces = [[[a, b, 0], [c, d, 0], [c, d, top], [a, b, top]] for a, b, c, d in walls]
    corners = [[0, 0], [width, 0], [width, depth], [0, depth]]
    faces += [[[*corner, height] for corner in corners] for height in (0, top)]
    concrete = rt.ITURadioMaterial("walls", "concrete", thickness=0.2)
    scene.edit(add=[surface(f"wall-{n}", face, concrete) for n, face in enumerate(faces)])
    return scene


def surface(name, corners, material):
    """A flat surface with four corners, one after the other round it."""
    mesh = Mesh(name, vertex_count=4, face_count=2)
    values = traverse(mesh)
    values["vertex_positions"] = np.ravel(corners).astype(np.float32)
    values["faces"] = np.array([0, 1, 2, 0, 2, 3], dtype=np.uint32)
    values.update()
    return rt.SceneObject(mi_mesh=mesh, name=name, radio_material=material)


def trace(scene, source_m, points_m, depth, at_once=300):
    """All paths from a place to each point, with at most ``depth`` reflections or walls."""
    solver = rt.PathSolver(deterministic=True)
    scene.add(rt.Transmitter("source", position=[float(x) for x in source_m]))
    found = []
    for first in range(0, len(points_m), at_once):
        some = points_m[first : first + at_once].tolist()
        for number, point in enumerate(some):
            scene.add(rt.Receiver(f"point-{number}", position=point))
        paths = solver(scene, max_depth=depth, samples_per_src=10**5)
        real, imaginary = (np.array(part)[:, 0, 0, 0] for part in paths.a)
        turn = np.exp(-2j * np.pi * float(scene.frequency[0]) * np.array(paths.tau)[:, 0])
        gain = np.where(np.array(paths.valid)[:, 0], (real + 1j * imaginary) * turn, 0.0)
        angles = (paths.theta_t, paths.phi_t), (paths.theta_r, paths.phi_r)
        found.append(Paths(gain, *(unit_vectors(*(np.array(a)[:, 0] for a in p)) for p in angles)))
        for number in range(len(some)):
            scene.remove(f"point-{number}")
    scene.remove("source")
    most = max(part.gain.shape[1] for part in found)
    return Paths(*(np.concatenate([padded(part[n], most) for part in found]) for n in range(3)))


def padded(array, most):
    """An array with zeros behind its second axis."""
    return np.pad(array, [(0, 0), (0, most - array.shape[1])] + [(0, 0)] * (array.ndim - 2))


def unit_vectors(theta, phi):
    """Directions of zenith and azimuth angles in rad, shape (..., 3)."""
    flat = np.sin(theta)
    return np.stack([flat * np.cos(phi), flat * np.sin(phi), np.cos(theta)], axis=-1)


def channels(config, free_space=False, depth=3):
    """Channels hbar and c_n at each cell, as ``env.channel.model=file`` takes them.

    On a path the panel is lit by a plane wave, as with ``ris.response=far``.
    """
    floor, scene = Floor.from_config(config), build_scene(config, free_space)
    points = np.column_stack(
        [floor.centres(), np.full(floor.cells, config.motion.antenna_height_m)]
    )
    middle = np.array([config.room.width_m / 2, config.room.depth_m / 2])
    ap, ris = (hung(place, middle, free_space) for place in (config.ap, config.ris))
    direct = trace(scene, ap, points, depth).gain.sum(axis=1)
    direct = np.where(np.abs(direct) < SILENT, SILENT, direct)
    reflected = np.zeros((floor.cells, config.ris.subsurfaces), dtype=complex)
    if config.ris.side:
        feed, away = trace(scene, ap, ris[None], depth), trace(scene, ris, points, depth)
        length_m = wavelength_m(config.channel.frequency_ghz)
        offsets = element_offsets_m(config.ris.side, config.ris.spacing * length_m, config.ris.axis)
        g = element_channels(feed.gain, feed.arrives, offsets, length_m)[0]
        for first in range(0, floor.cells, 100):
            part = slice(first, first + 100)
            h = element_channels(away.gain[part], away.leaves[part], offsets, length_m)
            reflected[part] = (h * g).reshape(len(h), config.ris.subsurfaces, -1).sum(axis=2)
    return direct.astype(complex), reflected


def hung(device, middle, free_space):
    """Where a device hangs: where it is configured, or a little off the wall behind it."""
    at = np.array(device.position_m)
    if not free_space:
        inwards = middle - at[:2]
        at[:2] += OFF_WALL_M * inwards / max(np.linalg.norm(inwards), 1e-9)
    return at


def element_channels(gain, direction, offsets_m, length_m):
    """What each element sends or receives over all paths, shape (Q, M)."""
    total = np.zeros((len(gain), len(offsets_m)), dtype=complex)
    for path in range(gain.shape[1]):
        ahead_m = direction[:, path] @ offsets_m.T
        total += gain[:, path, None] * np.exp(2j * np.pi * ahead_m / length_m)
    return total


def main():
    """Traces the room of a configuration and writes the file."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("file", help="the .npz file to write")
    parser.add_argument("overrides", nargs="*", metavar="KEY=VALUE", help="as risfleet train takes")
    parser.add_argument("--free-space", action="store_true", help="without walls, floor, ceiling")
    parser.add_argument("--depth", type=int, default=3, help="reflections and walls on a path")
    given = parser.parse_args()
    config = compose(given.overrides).env
    direct, reflected = channels(config, given.free_space, given.depth)
    write_channels(given.file, config, direct, reflected)
    print(f"{given.file}: {len(direct)} cells, {reflected.shape[1]} sub-surfaces")


if __name__ == "__main__":
    main()
