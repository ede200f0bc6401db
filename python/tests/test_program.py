"""The package computes the same numbers as the program, to the bit."""

from __future__ import annotations

import json
import subprocess
import tomllib
from pathlib import Path

import flankwatch
import numpy as np
import pytest
import soundfile

from conftest import ROOT, gear_signal


def run_json(program: Path, *arguments: object) -> list[dict]:
    done = subprocess.run([str(program), *map(str, arguments)], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


@pytest.mark.parametrize(
    ("arguments", "wanted"),
    [
        ([], {}),
        (["--wear-mm", "0.1", "--points", "64"], {"wear_um": 100.0, "points": 64}),
        (["--contact", "threshold", "--torque-nm", "500"], {"contact": "threshold", "torque_nm": 500.0}),
        (
            ["--turns", "40000", "--contact", "threshold", "--points", "50"],
            {"turns": 40000.0, "contact": "threshold", "points": 50},
        ),
    ],
)
def test_mesh_equals_the_model_command(program, arguments, wanted):
    rows = run_json(program, "model", "--format", "json", *arguments)
    cycle = flankwatch.Pair.shen2022().mesh(**wanted)
    for name in ("phi1_rad", "phi2_rad", "stiffness_n_per_m", "uste_rad", "pairs_in_contact"):
        assert [row[name] for row in rows] == getattr(cycle, name).tolist(), name


def test_wear_table_equals_the_model_command(program, tmp_path):
    rows = [[1, 68.0, 12.5], [1, 72.0, 3.25], [2, 74.0, 8.125], [2, 80.0, 1 / 3]]
    table = tmp_path / "wear.csv"
    table.write_text(
        "gear,radius_mm,depth_um\n"
        + "".join(f"{gear},{radius!r},{depth!r}\n" for gear, radius, depth in rows)
    )
    expected = run_json(program, "model", "--format", "json", "--profile", table, "--points", 40)
    cycle = flankwatch.Pair.shen2022().mesh(profile=np.array(rows), points=40)
    assert [row["stiffness_n_per_m"] for row in expected] == cycle.stiffness_n_per_m.tolist()
    assert (
        flankwatch.Pair.shen2022().mesh(profile=table.read_text(), points=40).uste_rad.tolist()
        == cycle.uste_rad.tolist()
    )


ASSET = """
id = "rig"
[gear]
teeth = [24, 26]
shaft_speed_hz = 24.5
[sensor]
unit = "m/s2"
"""


@pytest.mark.parametrize("speed_hz", [None, 25.0])
def test_indicators_equal_the_analyze_command(program, tmp_path, speed_hz):
    asset, wav = tmp_path / "rig.toml", tmp_path / "record.wav"
    asset.write_text(ASSET)
    x = gear_signal(3).astype(np.float32)
    soundfile.write(wav, x, 20_000, subtype="FLOAT")
    speed = [] if speed_hz is None else ["--shaft-speed-hz", speed_hz]
    (record,) = run_json(program, "analyze", wav, "--asset", asset, "--format", "json", *speed)
    found = flankwatch.indicators(
        x, 20_000.0, teeth=24, nominal_shaft_speed_hz=24.5, shaft_speed_hz=speed_hz, unit="m/s2"
    )
    # These depend on earlier records of the channel.
    stateful = {"na4", "nb4", "novelty"}
    assert {name: value for name, value in record["indicators"].items() if name not in stateful} == dict(
        found
    )
    assert {name: why for name, why in record["absent"].items() if name not in stateful} == found.absent
    assert record["shaft_speed_hz"] == found.shaft_speed_hz
    assert record["preprocessing"] == found.basis["preprocessing"]


@pytest.mark.parametrize(
    ("option", "wanted"),
    [("1000,2000", {"band_hz": [1000.0, 2000.0]}), ("kurtogram", {"search": "kurtogram"})],
)
def test_envelope_equals_the_analyze_command(program, tmp_path, option, wanted):
    wav = tmp_path / "record.wav"
    x = gear_signal(5).astype(np.float32)
    soundfile.write(wav, x, 20_000, subtype="FLOAT")
    (record,) = run_json(program, "analyze", wav, "--format", "json", "--envelope", option)
    envelope = flankwatch.envelope_spectrum(x, 20_000.0, **wanted)
    printed = record["envelope"]
    assert printed["band_hz"] == list(envelope.band_hz)
    assert printed["spectral_kurtosis"] == envelope.spectral_kurtosis
    amplitudes = dict(zip(envelope.frequency_hz.tolist(), envelope.amplitude.tolist()))
    assert len(printed["lines"]) == 8
    for line in printed["lines"]:
        assert amplitudes[line["frequency_hz"]] == line["amplitude"], line


def test_estimate_equals_the_analyze_command(program, tmp_path):
    """The program loads the library that the package builds."""
    pair_toml = (ROOT / "fixtures/pairs/shen2022.toml").read_text()
    pair = flankwatch.Pair.from_toml(pair_toml)
    assert pair.to_dict() == flankwatch.Pair.from_dict(tomllib.loads(pair_toml)).to_dict()
    library = flankwatch.Library.build(pair)
    data = tmp_path / "data"
    (data / "libraries").mkdir(parents=True)
    library.save(data / "libraries" / library.file_name)
    description = tmp_path / "rig.toml"
    nested = pair_toml.replace("\n[", "\n[gear.pair.")
    description.write_text(
        f'id = "rig"\n[gear]\nteeth = [24, 26]\nshaft_speed_hz = {pair.shaft_speed_hz}\n[sensor]\nunit = "m/s2"\n'
        f"[baseline]\nrecords = 8\n[limits]\ndanger_um = 200\n[gear.pair]\n{nested}"
    )
    run = flankwatch.Run(pair, records=12, seconds=1.0, interval_s=1.0, max_wear_um=200.0)
    files = []
    tracker = flankwatch.Tracker(library, baseline_records=8, limit_um=200.0)
    half = flankwatch.Tracker(library, baseline_records=8, limit_um=200.0)
    estimates = []
    for number, record in enumerate(run):
        path = tmp_path / f"{number:03}.wav"
        soundfile.write(path, record.samples, 20_000, subtype="FLOAT")
        files.append(path)
        estimates.append(tracker.update(record.samples, record.rate_hz, number)["wear"])
        if number == 5:
            tracker.save(tmp_path / "state.json")
            half.load(tmp_path / "state.json")
        if number > 5:
            assert half.update(record.samples, record.rate_hz, number)["wear"] == estimates[-1]
    assert half.state == tracker.state
    # The program's records follow each other, one second apart.
    records = run_json(
        program,
        "analyze",
        *files,
        "--asset",
        description,
        "--data-dir",
        data,
        "--members",
        0,
        "--format",
        "json",
    )
    assert [record["wear"] for record in records] == estimates
    assert estimates[-1]["library_id"] == library.id
    again = flankwatch.Library.load(data / "libraries" / library.file_name)
    assert (again.id, again.wear_um.tolist()) == (library.id, library.wear_um.tolist())
