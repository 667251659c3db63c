"""The radio map: the channels at every cell, built once per map seed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from env import propagation
from env.config import EnvConfig
from env.floor import Floor, line_of_sight
from env.seeding import Stream, stream


@dataclass(frozen=True)
class RadioMap:
    """Tables over cells; a step of the world looks up and never builds diag(Theta).

    Attributes:
        direct: hbar, the AP-robot channel, complex, shape (cells,).
        reflected: c_n, the AP-RIS-robot channel of each sub-surface at phase 0, (cells, N).
        settings: e^{j theta} of each action of the AP, shape (N_R^N, N).
        direct_db: |hbar|^2 in dB as robots measure it, float32, shape (cells,).
        direct_los: whether the AP is in line of sight, shape (cells,).
        ris_los: whether the RIS is in line of sight, shape (cells,).
    """

    direct: NDArray[np.complex128]
    reflected: NDArray[np.complex128]
    settings: NDArray[np.complex128]
    direct_db: NDArray[np.float32]
    direct_los: NDArray[np.bool_]
    ris_los: NDArray[np.bool_]

    def channel(
        self, cell: NDArray[np.int64], phase_action: NDArray[np.int64]
    ) -> NDArray[np.complex128]:
        """The combined channel h_k = h_k Theta g + hbar_k, which enters Eq. (1).

        Args:
            cell: where the robots are, shape (..., K).
            phase_action: the AP's action, shape (...).

        Returns:
            h_k, shape (..., K).
        """
        theta = self.settings[phase_action]
        reflected = (self.reflected[cell] * theta[..., None, :]).sum(axis=-1)
        return np.asarray(self.direct[cell] + reflected)


def build_radio_map(config: EnvConfig) -> RadioMap:
    """Builds the tables of a configuration from its ``map_seed``."""
    floor = Floor.from_config(config)
    centres = floor.centres()
    at = np.column_stack([centres, np.full(len(centres), config.motion.antenna_height_m)])
    ap, ris = np.asarray(config.ap.position_m), np.asarray(config.ris.position_m)
    frequency = config.channel.frequency_ghz

    direct_los = line_of_sight(ap, centres, floor.walls)
    loss_db = propagation.path_loss_db(_distance(at, ap), frequency, direct_los)
    fading = propagation.small_scale_fading(
        direct_los, config.channel.rician_k_db, stream(config.map_seed, Stream.RADIO_MAP)
    )
    direct = propagation.amplitude(loss_db) * fading

    ris_los = line_of_sight(ris, centres, floor.walls)
    feed_los = line_of_sight(ris, ap[None, :2], floor.walls)
    incoming = propagation.path_loss_db(_distance(ap[None], ris), frequency, feed_los)
    outgoing = propagation.path_loss_db(_distance(at, ris), frequency, ris_los)
    reflected = propagation.coherent_response(
        float(propagation.amplitude(incoming)[0]),
        propagation.amplitude(outgoing),
        config.ris.side**2,
        config.ris.subsurfaces,
    )
    return RadioMap(
        direct=direct,
        reflected=reflected,
        settings=propagation.phase_settings(config.ris.bits, config.ris.subsurfaces),
        direct_db=(20.0 * np.log10(np.abs(direct))).astype(np.float32),
        direct_los=direct_los,
        ris_los=ris_los,
    )


def _distance(
    points_m: NDArray[np.float64], end_m: NDArray[np.float64], least_m: float = 0.5
) -> NDArray[np.float64]:
    """3-D distances in m, shape (P,); no shorter than half a metre, where the model ends."""
    return np.asarray(np.maximum(np.linalg.norm(points_m - end_m, axis=-1), least_m))
