"""What is allowed of an RIS whose elements have places: how many, and their codebook."""

from __future__ import annotations

import math

from env.config import MAX_PAIRS, MAX_PHASE_ACTIONS, EnvConfig, phase_actions
from env.validate import Problem


def pair_problems(config: EnvConfig) -> list[Problem]:
    """Whether the distances from every element to every cell are too many to work out."""
    ris, room = config.ris, config.room
    cells = round(room.width_m / room.cell_m) * round(room.depth_m / room.cell_m)
    if ris.response not in ("far", "near") or ris.side**2 * cells <= MAX_PAIRS:
        return []
    allowed = (
        f"at most {math.isqrt(MAX_PAIRS // cells)} with env.ris.response={ris.response} and"
        f" {cells} cells, since elements times cells may be {MAX_PAIRS} at most"
    )
    return [("env.ris.side", ris.side, allowed)]


def codebook_problems(config: EnvConfig) -> list[Problem]:
    """Whether beams can be made: from places of elements, for sectors that have cells."""
    ris, room, say = config.ris, config.room, "with env.ris.action=codebook"
    if ris.action != "codebook":
        return []
    if ris.response not in ("far", "near"):
        allowed = f"far or near {say}, since a beam needs elements with places"
        return [("env.ris.response", ris.response, allowed)]
    if config.channel.model != "indoor_hotspot":
        allowed = f"indoor_hotspot {say}: another model gives no channel of each element"
        return [("env.channel.model", config.channel.model, allowed)]
    if ris.subsurfaces != 1:
        allowed = f"1 {say}, which sets every element by itself"
        return [("env.ris.subsurfaces", ris.subsurfaces, allowed)]
    if ris.side == 0:
        return [("env.ris.side", ris.side, f"at least 1 {say}")]
    cells = [round(length / room.cell_m) for length in (room.width_m, room.depth_m)]
    shape = len(ris.sectors) == 2 and all(isinstance(number, int) for number in ris.sectors)
    if not shape or not all(1 <= n <= most for n, most in zip(ris.sectors, cells, strict=True)):
        allowed = f"[columns, rows] of 1 to {cells[0]} and 1 to {cells[1]}, the cells there are"
        return [("env.ris.sectors", ris.sectors, allowed)]
    if phase_actions(ris) > MAX_PHASE_ACTIONS:
        allowed = f"at most {MAX_PHASE_ACTIONS} sectors, each of which is an action of the AP"
        return [("env.ris.sectors", ris.sectors, allowed)]
    return []
