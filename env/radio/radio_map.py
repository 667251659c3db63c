"""The radio map: the channels at every cell, built once per map seed."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from env import plugins
from env.arrays import Bools, Complexes, Floats, Floats32, Ints
from env.config import EnvConfig, RisConfig, phase_actions
from env.geometry.floor import Floor
from env.radio import codebook, mounting, propagation
from env.radio.channel_file import read_channels
from env.seeding import Stream, stream

MAX_TABLE = 2**20
"""Most entries of a table of gains: 8 MB."""


@dataclass(frozen=True)
class RadioMap:
    """Tables over cells; a step of the world looks up and never builds diag(Theta).

    Attributes:
        direct: hbar, the AP-robot channel, complex, shape (cells,); with ``channel.fading=slot``
            its part that stays, by which the world multiplies each slot's fading.
        reflected: c_n, the AP-RIS-robot channel of each sub-surface at phase 0, (cells, N); with
            ``ris.action=codebook`` that of the whole surface under each beam, (cells, beams).
        settings: e^{j theta} of each action of the AP, shape (N_R^N, N); ones of shape
            (beams, 1) with a codebook, whose phases ``reflected`` contains.
        direct_db: |direct|^2 in dB as robots measure it, float32, shape (cells,).
        direct_los: whether the AP is in line of sight, shape (cells,).
        ris_los: whether the RIS is in line of sight, shape (cells,).
        codebook: whether an action is a beam, a column of ``reflected``.
    """

    direct: Complexes
    reflected: Complexes
    settings: Complexes
    direct_db: Floats32
    direct_los: Bools
    ris_los: Bools
    codebook: bool = False

    def channel(self, cell: Ints, phase_action: Ints, direct: Complexes | None = None) -> Complexes:
        """The combined channel h_k = h_k Theta g + hbar_k, which enters Eq. (1), shape (..., K).

        Args:
            cell: where the robots are, shape (..., K).
            phase_action: the AP's action, shape (...).
            direct: hbar_k where it is not the map's, shape (..., K).
        """
        if self.codebook:
            reflected = self.reflected[cell, phase_action[..., None]]
        else:
            theta = self.settings[phase_action]
            reflected = (self.reflected[cell] * theta[..., None, :]).sum(axis=-1)
        return np.asarray((self.direct[cell] if direct is None else direct) + reflected)

    def gain(self, cell: Ints, phase_action: Ints, direct: Complexes | None = None) -> Floats:
        """|h_k|^2 of ``channel``, with the same arguments; looked up where there are few."""
        if direct is None and self._gains is not None:
            return self._gains[phase_action[..., None], cell]
        return _squared(self.channel(cell, phase_action, direct))

    @cached_property
    def _gains(self) -> Floats | None:
        """|h|^2 for every action at every cell, shape (A, cells); None where that is a lot."""
        shape = (len(self.settings), len(self.direct))
        if shape[0] * shape[1] > MAX_TABLE:
            return None
        cell = np.broadcast_to(np.arange(shape[1]), shape)
        return _squared(self.channel(cell, np.arange(shape[0])))


def _squared(channel: Complexes) -> Floats:
    """|h|^2, same shape."""
    return np.asarray(channel.real**2 + channel.imag**2)


def build_radio_map(config: EnvConfig, floor: Floor | None = None) -> RadioMap:
    """Builds the tables of a configuration from its ``map_seed``; its floor is made if None.

    Raises:
        PluginError: the user's channel model or file is not there or does not fit.
    """
    floor = floor or Floor.from_config(config)
    centres = floor.centres()
    at = np.column_stack([centres, np.full(len(centres), config.motion.antenna_height_m)])
    direct_los = mounting.sees(floor, config.ap.position_m, centres)
    ris_los = mounting.sees(floor, config.ris.position_m, centres)
    from_file = config.channel.model == "file"
    own = read_channels(config, floor) if from_file else plugins.own_channel(config, floor)
    direct, reflected = own or (
        _direct(config, at, direct_los),
        _reflected(config, floor, at, ris_los),
    )
    return RadioMap(
        direct=direct,
        reflected=reflected,
        settings=_settings(config.ris),
        direct_db=(20.0 * np.log10(np.abs(direct))).astype(np.float32),
        direct_los=direct_los,
        ris_los=ris_los,
        codebook=config.ris.action == "codebook",
    )


def _settings(ris: RisConfig) -> Complexes:
    """What the AP's actions are, ``RadioMap.settings``."""
    if ris.action == "codebook":
        return np.ones((phase_actions(ris), 1), dtype=np.complex128)
    return propagation.phase_settings(ris.bits, ris.subsurfaces)


def _direct(config: EnvConfig, at: Floats, los: Bools) -> Complexes:
    """The direct channel at points in m, shape (P,), without the fading of a slot."""
    channel = config.channel
    distance_m = _distance(at, np.asarray(config.ap.position_m))
    loss_db = propagation.path_loss_db(distance_m, channel.frequency_ghz, los)
    direct = propagation.amplitude(loss_db).astype(np.complex128)
    if channel.fading == "static":
        generator = stream(config.map_seed, Stream.RADIO_MAP)
        direct *= propagation.small_scale_fading(los, channel.rician_k_db, generator)
    if channel.los_phase == "distance":
        wavelength_m = propagation.wavelength_m(channel.frequency_ghz)
        direct *= propagation.path_phase(distance_m, wavelength_m)
    return direct


def _reflected(config: EnvConfig, floor: Floor, at: Floats, los: Bools) -> Complexes:
    """c_n at points in m, shape (P, N), or c under each beam, shape (P, beams)."""
    ap, ris = np.asarray(config.ap.position_m), np.asarray(config.ris.position_m)
    frequency = config.channel.frequency_ghz
    feed_los = mounting.see_each_other(floor, config.ris.position_m, config.ap.position_m)
    feed_m, distance_m = _distance(ap[None], ris), _distance(at, ris)
    incoming = propagation.path_loss_db(feed_m, frequency, feed_los)
    outgoing = propagation.path_loss_db(distance_m, frequency, los)
    reflected = _response(
        config,
        floor,
        float(propagation.amplitude(incoming)[0]),
        propagation.amplitude(outgoing),
        ap - ris,
        at - ris,
    )
    if config.channel.los_phase == "distance":
        wavelength_m = propagation.wavelength_m(frequency)
        reflected *= propagation.path_phase(feed_m + distance_m, wavelength_m)[:, None]
    return reflected


def _response(
    config: EnvConfig,
    floor: Floor,
    incoming: float,
    outgoing: Floats,
    ap_m: Floats,
    points_m: Floats,
) -> Complexes:
    """c_n at points seen from the panel's centre, the phase at the centre zero, shape (P, N)."""
    ris = config.ris
    elements = ris.side**2
    if ris.response == "coherent":
        return propagation.coherent_response(incoming, outgoing, elements, ris.subsurfaces)
    if ris.response == "rayleigh":
        generator = stream(config.map_seed, Stream.RADIO_MAP, 1)
        return propagation.rayleigh_response(
            incoming, outgoing, elements, ris.subsurfaces, generator
        )
    if ris.action == "codebook":
        panel = codebook.Panel.from_config(config)
        sector = codebook.sector_of_cells(floor, *ris.sectors)
        index = codebook.beams(panel, points_m, sector, ris.bits)
        return incoming * outgoing[:, None] * codebook.factors(panel, points_m, index, ris.bits)
    far = ris.response == "far"
    excess = propagation.far_excess_m if far else propagation.near_excess_m
    wavelength_m = propagation.wavelength_m(config.channel.frequency_ghz)
    offsets_m = propagation.element_offsets_m(ris.side, ris.spacing * wavelength_m, ris.axis)
    factor = propagation.array_factor(
        ap_m, points_m, offsets_m, ris.subsurfaces, wavelength_m, excess
    )
    return incoming * outgoing[:, None] * factor


def _distance(points_m: Floats, end_m: Floats, least_m: float = 0.5) -> Floats:
    """3-D distances in m, shape (P,); no shorter than half a metre, where the model ends."""
    return np.asarray(np.maximum(np.linalg.norm(points_m - end_m, axis=-1), least_m))
