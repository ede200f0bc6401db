"""The import of folders against a running service."""

from __future__ import annotations

import gzip
import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import flankwatch
import numpy as np
import pytest
import scipy.io
import soundfile
from flankwatch.import_state import FILE_NAME
from flankwatch.importing import main, time_in_name

from conftest import gear_signal

RATE_HZ = 20_000.0


def starts(client, asset, **parameters):
    return [segment["start_time"] for segment in client.segments(asset, **parameters)]


def samples(client, segment):
    return np.asarray(client.waveform(segment["id"], max_points=200_000)["value"], dtype=np.float32)


def write_mats(folder, count, seconds=0.4):
    folder.mkdir(parents=True, exist_ok=True)
    for hour in range(count):
        content = {"a1": gear_signal(hour)[: int(RATE_HZ * seconds)], "fs": RATE_HZ, "unit": "m/s2"}
        scipy.io.savemat(folder / f"20260301_{hour:02}0000.mat", content)


@pytest.fixture
def run(service, asset, capsys):
    """Imports a folder into the asset. Returns the exit status and the output."""

    def run(folder, *options):
        status = main([str(folder), "--asset", asset, "--url", service[0], *map(str, options)])
        output = capsys.readouterr()
        return status, output.out, output.err

    return run


PATTERN = ("--time-pattern", "%Y%m%d_%H%M%S")


def test_a_folder_is_imported_once(client, asset, run, tmp_path):
    folder = tmp_path / "recordings" / "day 1"
    write_mats(folder, 3)
    soundfile.write(folder / "20260301_040000.wav", gear_signal(9)[:8000], int(RATE_HZ), subtype="FLOAT")
    (folder / "20260301_050000.mat").write_bytes(b"MATLAB 5.0 MAT-file broken")
    (folder / "notes.txt").write_text("no recording")
    status, out, err = run(tmp_path, *PATTERN)
    assert status == 1 and out.count(": stored") == 4 and "20260301_050000.mat: error: " in out
    assert "1 of 5 files were not sent" in err and "[5/5, 0 s left]" in out
    # What was sent is skipped, what failed is tried again.
    status, out, _ = run(tmp_path, *PATTERN)
    assert status == 1 and out.count(": sent before") == 4 and out.count(": error: ") == 1
    # Without the state, the service recognises the recordings.
    (tmp_path / FILE_NAME).unlink()
    status, out, _ = run(tmp_path, *PATTERN)
    assert status == 1 and out.count(": already stored") == 4
    assert starts(client, asset) == [f"2026-03-01T0{hour}:00:00Z" for hour in (0, 1, 2, 4)]
    second = list(client.segments(asset))[1]
    assert np.array_equal(samples(client, second), gear_signal(1)[:8000].astype(np.float32))


def test_a_killed_import_continues(client, service, asset, run, tmp_path, monkeypatch):
    """Killed after some answers, it stores every record once and sends no acknowledged file again."""
    count = 30
    write_mats(tmp_path, 24)
    for extra in range(count - 24):
        content = {"a1": gear_signal(extra)[:8000], "fs": RATE_HZ}
        scipy.io.savemat(tmp_path / f"20260302_{extra:02}0000.mat", content)
    command = [sys.executable, "-m", "flankwatch", "import", tmp_path, "--asset", asset, "--url", service[0]]
    with subprocess.Popen([*command, *PATTERN], stdout=subprocess.PIPE, text=True) as process:
        acknowledged = []
        for line in process.stdout:
            acknowledged.append(line.split(": ")[0].split("] ")[1])
            if len(acknowledged) == 5:
                process.send_signal(signal.SIGKILL)
    assert 5 <= len(acknowledged) < count
    # A line that was cut off is ignored.
    with (tmp_path / FILE_NAME).open("ab") as state:
        state.write(b'{"destination": "')
    sent = []
    upload = flankwatch.Client._upload

    def counting(self, *arguments):
        sent.append(arguments)
        return upload(self, *arguments)

    monkeypatch.setattr(flankwatch.Client, "_upload", counting)
    status, out, _ = run(tmp_path, *PATTERN)
    assert status == 0
    assert all(f"{path}: sent before" in out for path in acknowledged)
    # At most the file whose answer was not written is sent again.
    assert len(sent) == count - out.count(": sent before") and out.count(": already stored") <= 1
    assert len(set(starts(client, asset))) == len(starts(client, asset)) == count
    sent.clear()
    assert run(tmp_path, *PATTERN)[1].count(": sent before") == count and not sent


def test_a_lost_answer_stores_nothing_twice(client, asset, run, tmp_path, monkeypatch):
    write_mats(tmp_path, 4)
    upload = flankwatch.Client._upload
    calls = []

    def losing(self, *arguments):
        answer = upload(self, *arguments)
        calls.append(answer)
        if len(calls) == 2:
            raise KeyboardInterrupt
        return answer

    monkeypatch.setattr(flankwatch.Client, "_upload", losing)
    status, out, err = run(tmp_path, *PATTERN)
    assert (status, out.count(": stored")) == (130, 1) and "stopped after 1 of 4 files" in err
    status, out, _ = run(tmp_path, *PATTERN)
    assert status == 0
    assert [out.count(words) for words in (": sent before", ": already stored", ": stored")] == [1, 1, 2]
    assert starts(client, asset) == [f"2026-03-01T0{hour}:00:00Z" for hour in range(4)]


def test_a_changed_file_and_other_options_are_sent(client, asset, run, tmp_path):
    np.save(tmp_path / "a.npy", gear_signal(1)[:8000])
    options = ("--rate-hz", 20_000, "--start-time", "2026-03-01T08:00:00Z", "--state", tmp_path / "state")
    assert ": stored" in run(tmp_path, *options)[1]
    assert ": sent before" in run(tmp_path, *options)[1]
    assert json.loads((tmp_path / "state").read_text())["file"] == "a.npy"
    # Sent again, although the server refuses other values for a stored record.
    assert "409: torque_nm is 5" in run(tmp_path, *options, "--torque-nm", 5)[1]
    np.save(tmp_path / "a.npy", gear_signal(2)[:8000])
    os.utime(tmp_path / "a.npy", (1, 1))
    assert ": stored" in run(tmp_path, *options)[1]


FEMTO = "{hour},{minute},{second},{us},{x},{y}\n"


def write_femto(path, hour, minute, second, seed):
    """Writes hour, minute, second and microsecond in the first four columns, as the FEMTO set does."""
    x = np.round(np.random.default_rng(seed).normal(size=(2, 256)), 3)
    lines = [
        FEMTO.format(hour=hour, minute=minute, second=second, us=round(n * 1e6 / 2560), x=x[0, n], y=x[1, n])
        for n in range(256)
    ]
    path.write_text("".join(lines))
    return x.astype(np.float32)


def test_times_of_day_count_from_the_start_time_as_in_the_program(client, program, run, tmp_path):
    asset = "femto"
    client.create_asset({"id": asset, "gear": {"teeth": [24, 36], "shaft_speed_hz": 24.5}})
    write_femto(tmp_path / "acc_1.csv", 9, 39, 39, 1)
    write_femto(tmp_path / "acc_2.csv", 23, 59, 59, 2)
    last = write_femto(tmp_path / "acc_3.csv", 0, 9, 39, 3)
    status, out, _ = run(tmp_path, "--asset", asset, "--unit", "g")
    assert status == 1 and "--start-time is missing, expected a time from which" in out
    # One second of slack: the first file begins half a second before.
    start_time = ("--start-time", "2010-11-17T09:39:39.5Z")
    start = ("--asset", asset, "--unit", "g", *start_time)
    assert run(tmp_path, *start)[0] == 0
    expected = ["2010-11-17T09:39:39Z", "2010-11-17T23:59:59Z", "2010-11-18T00:09:39Z"]
    assert starts(client, asset, channel="5") == starts(client, asset, channel="6") == expected
    segment = list(client.segments(asset, channel="6"))[2]
    assert segment["unit"] == "g" and np.array_equal(samples(client, segment), last[1])
    files = sorted(tmp_path.glob("*.csv"))
    command = [program, "analyze", *files, *start_time, "--format", "json"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    records = [record for record in json.loads(done.stdout) if record["channel"] == "6"]
    assert [record["start_time"] for record in records] == expected
    # A restart knows the end of the files that it skips.
    write_femto(tmp_path / "acc_4.csv", 0, 9, 38, 4)
    assert run(tmp_path, *start)[1].count(": sent before") == 3
    assert starts(client, asset, channel="5")[3:] == ["2010-11-19T00:09:38Z"]


def test_recordings_without_a_time_follow_one_another(client, asset, run, tmp_path):
    for name in ("a", "b"):
        soundfile.write(tmp_path / f"{name}.wav", gear_signal(1)[:10_000], 20_000, subtype="FLOAT")
    np.save(tmp_path / "c.npy", gear_signal(2)[:10_000])
    assert run(tmp_path, "--start-time", "2026-03-01T08:00:00Z", "--rate-hz", 20_000)[0] == 0
    assert starts(client, asset) == ["2026-03-01T08:00:00Z", "2026-03-01T08:00:00.5Z", "2026-03-01T08:00:01Z"]


def test_channels_of_csv_and_wav_are_chosen(client, asset, run, tmp_path):
    x = np.round(np.array([gear_signal(1)[:400], gear_signal(2)[:400]]), 3).astype(np.float32)
    text = "in [m/s2];out [m/s2]\n" + "".join(f"{a};{b}\n" for a, b in x.T)
    (tmp_path / "a.csv").write_text(text)
    with gzip.open(tmp_path / "b.csv.gz", "wt") as file:
        file.write(text)
    options = ("--rate-hz", 1000, "--channels", "out", "--start-time", "2026-03-01T08:00:00Z")
    assert run(tmp_path, *options)[0] == 0
    segments = list(client.segments(asset))
    assert [segment["channel"] for segment in segments] == ["out", "out"]
    assert all(np.array_equal(samples(client, segment), x[1]) for segment in segments)
    soundfile.write(tmp_path / "c.wav", x.T, 1000, subtype="FLOAT")
    status, out, _ = run(tmp_path / "c.wav", "--channels", "2", "--start-time", "2026-03-02T08:00:00Z")
    assert status == 0
    (segment,) = client.segments(asset, channel="2")
    assert np.array_equal(samples(client, segment), x[1])
    status, out, _ = run(tmp_path, "--channels", "3", "--rate-hz", "1000")
    assert "c.wav: error: --channels: no channel '3', expected one of 1, 2" in out
    assert "a.csv: error: --channels: " in out
    assert 'no column "3", expected one of in [m/s2], out [m/s2]' in out


def test_gzipped_csv_is_sent_unchanged(client, asset, run, tmp_path):
    x = np.round(gear_signal(1)[:400], 3).astype(np.float32)
    with gzip.open(tmp_path / "20260301_080000.csv.gz", "wt") as file:
        file.write("in [m/s2]\n" + "".join(f"{value}\n" for value in x))
    status, out, _ = run(tmp_path, "--rate-hz", 1000, *PATTERN)
    assert status == 0, out
    (segment,) = client.segments(asset)
    assert np.array_equal(samples(client, segment), x) and segment["start_time"] == "2026-03-01T08:00:00Z"
    raw = client._send("GET", f"/v1/segments/{segment['id']}/raw").content
    assert raw.startswith(b"in [m/s2]\n")


def test_volts_become_g_by_scale_and_sensitivity(client, service, run, tmp_path):
    asset = "volts"
    client.create_asset({"id": asset, "gear": {"teeth": [24, 36], "shaft_speed_hz": 24.5}})
    x = np.round(gear_signal(1)[:8000] * 1000).astype(np.int16)
    soundfile.write(tmp_path / "a.wav", x, 20_000)
    np.savetxt(tmp_path / "b.csv", x, header="in [V]", comments="")
    options = ["--asset", asset, "--start-time", "2026-03-01T08:00:00Z", "--rate-hz", 20_000]
    assert run(tmp_path, *options, "--scale", 5, "--sensitivity-mv-per-g", 100)[0] == 0
    wav, csv = client.segments(asset)
    assert {wav["unit"], csv["unit"]} == {"g"} and csv["channel"] == "in"
    # Full scale is 5 V, and 0.1 V is 1 g.
    assert np.array_equal(samples(client, wav), (x / 32768 * 50).astype(np.float32))
    assert np.array_equal(samples(client, csv), (x * 50.0).astype(np.float32))
    np.savetxt(tmp_path / "c.csv", x, header="in [m/s2]", comments="")
    status, out, _ = run(tmp_path / "c.csv", *options, "--sensitivity-mv-per-g", 100)
    assert status == 1
    assert "--sensitivity-mv-per-g is 100.0, expected none: channel 'in' is in 'm/s2', not in volts" in out


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--scale", "0"], "--scale is 0.0, expected a finite number other than 0"),
        (
            ["--sensitivity-mv-per-g", "-1"],
            "--sensitivity-mv-per-g is -1.0, expected a finite number above 0",
        ),
        (["--sensitivity-mv-per-g", "1", "--unit", "m/s2"], "--unit is 'm/s2', expected none with"),
        (["--start-time", "noon"], "--start-time is 'noon', expected an RFC 3339 time"),
        (["--state", "/proc/none/state"], "expected --state FILE"),
    ],
)
def test_invalid_options_are_refused_at_once(run, tmp_path, options, message):
    write_mats(tmp_path, 1)
    status, out, err = run(tmp_path, *options)
    assert status == 1 and not out and message in err


def test_options_that_do_not_fit_a_file_are_refused(client, asset, run, tmp_path):
    soundfile.write(tmp_path / "a.wav", gear_signal(1)[:8000], 20_000)
    (tmp_path / "b.mcap").write_bytes(b"\x89MCAP0\r\n")
    status, out, _ = run(tmp_path, "--rate-hz", 10_000)
    assert status == 1
    assert "a.wav: error: --rate-hz is 10000.0, expected 20000 as in the header, or none" in out
    assert "b.mcap: error: --rate-hz is 10000.0, expected none: an MCAP recording contains it" in out
    assert not starts(client, asset)


def test_import_errors_are_reported(run, tmp_path, capsys):
    assert "no recording in" in run(tmp_path)[2]
    np.save(tmp_path / "x.npy", np.arange(100.0))
    status, out, _ = run(tmp_path)
    assert status == 1 and "channel '1' has no sampling rate, expected --rate-hz" in out
    nowhere = ["--url", "http://127.0.0.1:1"]
    assert run(tmp_path, *nowhere)[0] == 1
    status, _, err = run(tmp_path, *nowhere, "--rate-hz", 100)
    assert status == 1 and "http://127.0.0.1:1 cannot be reached" in err


def test_a_time_in_a_name_is_in_utc_unless_the_pattern_has_an_offset():
    pattern = PATTERN[1]
    assert time_in_name(Path("20260301_100000.csv.gz"), pattern) == "2026-03-01T10:00:00Z"
    assert time_in_name(Path("20260301_100000+0200.wav"), f"{pattern}%z") == "2026-03-01T08:00:00Z"


def test_a_certificate_that_cannot_be_read_is_named(run, tmp_path):
    write_mats(tmp_path, 1)
    status, _, err = run(tmp_path, *PATTERN, "--ca", tmp_path / "none.pem")
    assert status == 1 and "--ca is" in err and "none.pem" in err
