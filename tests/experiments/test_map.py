"""``risfleet map``, and a tiny run with a codebook."""

import json

import numpy as np
import pytest

from env.radio.radio_map import build_radio_map
from experiments.cli import main
from experiments.commands.map import gains_db, means
from training.preflight import checked

BEAMS = ("env.ris.response=near", "env.ris.action=codebook", "env.ris.sectors=[2,2]")


def test_the_map_is_printed_written_and_drawn(tiny_overrides, tmp_path, capsys):
    out, file = tmp_path / "map.png", tmp_path / "map.json"
    assert main(["map", *tiny_overrides, *BEAMS, "--out", str(out), "--json", str(file)]) == 0
    printed = capsys.readouterr().out
    assert "4 beams of the codebook" in printed
    assert "AP's shadow" in printed
    assert out.read_bytes().startswith(b"\x89PNG")
    written = json.loads(file.read_text())
    assert f"{written['4 beams of the codebook']['all_db']:.1f}" in printed
    assert written["continuous phases, a bound"]["shadow_db"] > 0


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["env.ris.action=beams"], "env.ris.action=beams: allowed is phases or codebook"),
        (["env.ris.action=codebook"], "env.ris.response=coherent: allowed is far or near"),
        (["env.ris.sort=1"], "env.ris.sort"),
        (["--out", "map.pdf"], "ends in .png"),
        (["--json", "nowhere/at/all.json"], "a folder that exists"),
    ],
)
def test_what_is_wrong_is_said_in_one_sentence(arguments, says, capsys):
    assert main(["map", *arguments]) == 2
    printed = capsys.readouterr()
    assert says in printed.err
    assert printed.out == ""
    assert len(printed.err.strip().splitlines()) == 1


@pytest.mark.parametrize("response", ["coherent", "far", "near", "rayleigh"])
@pytest.mark.parametrize("side", [0, 3])
def test_no_setting_gains_more_than_the_bound(tiny_overrides, response, side):
    beams = side and response in ("far", "near")
    config = checked(
        [
            *tiny_overrides,
            f"env.ris.side={side}",
            f"env.ris.response={response}",
            *(["env.ris.action=codebook", "env.ris.sectors=[2,3]"] if beams else []),
        ]
    ).env
    gains = gains_db(config, build_radio_map(config))
    bound = gains.pop("continuous phases, a bound", None)
    assert (bound is None) == (response == "rayleigh")
    assert ("6 beams of the codebook" in gains) == bool(beams)
    for gain in gains.values():
        assert gain.shape == (48,)
        assert bound is None or (gain <= bound + 1e-9).all()
        assert side or abs(gain).max() == 0


def test_where_the_ap_sees_every_cell_there_is_no_shadow(tiny_overrides, capsys):
    open_floor = [*tiny_overrides, "env.walls.segments=[]"]
    config = checked(open_floor).env
    tables = build_radio_map(config)
    found = means(gains_db(config, tables), tables.direct_los, np.ones(48, dtype=bool))
    assert all(row["shadow_db"] is None for row in found.values())
    assert main(["map", *open_floor]) == 0
    rows = [line for line in capsys.readouterr().out.splitlines() if line.startswith("│")]
    assert len(rows) == len(found)
    assert all(row.split("│")[3].strip() == "-" for row in rows)


def test_cells_that_nobody_reaches_do_not_count():
    gains, los = {"a": np.array([1.0, 2.0, 4.0, 9.0])}, np.array([True, True, False, False])
    every, some = np.ones(4, dtype=bool), np.array([True, True, True, False])
    assert means(gains, los, every) == {"a": {"all_db": 4.0, "shadow_db": 6.5}}
    assert means(gains, los, some) == {"a": {"all_db": 7 / 3, "shadow_db": 4.0}}


def test_a_run_with_a_codebook_trains_an_access_point_with_an_output_for_each_beam(
    tiny_overrides, tmp_path
):
    folder = tmp_path / "run"
    assert main(["train", *tiny_overrides, *BEAMS, f"run.dir={folder}"]) == 0
    summary = json.loads((folder / "summary.json").read_text())
    assert summary["digest"]["ap"]
    assert main(["evaluate", str(folder), "--episodes", "2"]) == 0
