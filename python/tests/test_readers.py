"""Each reader returns the samples written by another library, in ten files per format."""

from __future__ import annotations

import datetime
import sys
from pathlib import Path

import flankwatch
import numpy as np
import pyarrow as pa
import pyarrow.parquet
import pytest
import pyuff
import scipy.io
import scipy.io.wavfile
import soundfile
from flankwatch.reading.guess import split_unit
from flankwatch.recording import Channel, Recording
from flankwatch.uploads import scaled

from conftest import real_data
from recordings import RATE_HZ, SUBTYPES, WRITERS, signals, write_flac, write_npy, write_wav


@pytest.mark.parametrize("number", range(10))
@pytest.mark.parametrize("name", WRITERS)
def test_samples_rate_and_unit_are_those_written(tmp_path, name, number):
    x = signals(number)
    path = tmp_path / f"recording.{number}"
    WRITERS[name](path, x, number)
    recording = flankwatch.read(path)
    prefix = "measurement/" if name == "hdf5" else ""
    for (channel, samples), found in zip(x.items(), recording, strict=True):
        assert found.name.removeprefix(prefix).split(" ")[0] == channel
        expected = samples.astype(np.float32) if name == "csv" else samples
        if name == "uff":
            # Text formats have a limited number of digits.
            sets = pyuff.UFF(str(path)).read_sets()
            expected = sets[list(x).index(channel)]["data"]
            assert np.allclose(expected, samples, rtol=1e-4, atol=1e-4)
        assert found.samples.tolist() == expected.tolist()
        assert found.rate_hz == pytest.approx(RATE_HZ, rel=1e-5)
        assert found.unit == "g"
        if name == "tdms":
            assert found.start_time == np.datetime64("2026-03-01T08:00:00.25")


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("acc [m/s2]", ("acc", "m/s2")),
        ("acc (g)", ("acc", "g")),
        ("Zeit (ms)", ("Zeit", "ms")),
        ("t (s)", ("t", "s")),
        ("ch1 (mV)", ("ch1", "mV")),
        ("ch1 [V]", ("ch1", "V")),
        ("ratio [1]", ("ratio", "1")),
        *((name, (name, None)) for name in ("DE (V)", "DE (H)", "DE (A)", "Acc (1)", "Acc [2]", "a []")),
    ],
)
def test_directions_and_numbers_in_brackets_are_no_units(name, expected):
    assert split_unit(name) == expected


def test_a_sensitivity_converts_volts_and_millivolts():
    for unit, factor in [("V", 20.0), (None, 20.0), ("mV", 0.02)]:
        channel = Channel("a", np.array([1.0, -3.0]), 10.0, unit)
        (found,) = scaled(Recording(Path("a.csv"), "csv", [channel]), 2.0, 100.0)
        assert found.unit == "g" and found.samples == pytest.approx([factor, -3 * factor])
    with pytest.raises(flankwatch.RecordingError, match="is in 'g', not in volts or mV"):
        scaled(Recording(Path("a.csv"), "csv", [Channel("a", np.ones(2), 10.0, "g")]), None, 100.0)


@pytest.mark.parametrize("number", range(10))
def test_numpy_files_have_their_samples(tmp_path, number):
    x, path = signals(number), tmp_path / "recording.npy"
    write_npy(path, x, number)
    recording = flankwatch.read(path, rate_hz=RATE_HZ, unit="m/s2", start_time=datetime.datetime(2026, 3, 1))
    assert [channel.samples.tolist() for channel in recording] == [samples.tolist() for samples in x.values()]
    assert recording["channel_2"].unit == "m/s2"
    assert recording[0].start_time == np.datetime64("2026-03-01")
    assert recording[0].samples.dtype == x["a1"].dtype


@pytest.mark.parametrize("number", range(10))
def test_flac_has_the_samples_of_soundfile(tmp_path, number):
    path = tmp_path / "recording.flac"
    write_flac(path, signals(number), number)
    expected, rate_hz = soundfile.read(path)
    recording = flankwatch.read(path)
    assert np.array_equal(np.array([channel.samples for channel in recording]).T, expected)
    assert {channel.rate_hz for channel in recording} == {rate_hz} and recording.names == ["1", "2"]


@pytest.mark.filterwarnings("ignore::scipy.io.wavfile.WavFileWarning")
@pytest.mark.parametrize("number", range(12))
def test_wav_has_the_samples_of_scipy(tmp_path, number):
    path = tmp_path / "recording.wav"
    write_wav(path, signals(number), number)
    rate_hz, samples = scipy.io.wavfile.read(path)
    if samples.dtype == np.uint8:
        expected = (samples.astype(float) - 128) / 128
    elif samples.dtype.kind == "i":
        # SciPy returns 24 bits in the upper bytes of 32.
        expected = samples / 2.0 ** (8 * samples.dtype.itemsize - 1)
    else:
        expected = samples.astype(float)
    recording = flankwatch.read(path)
    assert np.array_equal(np.array([channel.samples for channel in recording]).T, expected)
    assert {channel.rate_hz for channel in recording} == {rate_hz}, SUBTYPES[number % len(SUBTYPES)]


def test_a_rate_that_contradicts_a_header_is_refused(tmp_path):
    path = tmp_path / "recording.wav"
    write_wav(path, signals(0), 0)
    assert flankwatch.read(path, rate_hz=RATE_HZ)[0].rate_hz == RATE_HZ
    with pytest.raises(flankwatch.RecordingError, match="rate_hz is 10000, expected 12800") as refused:
        flankwatch.read(path, rate_hz=10_000)
    assert (refused.value.argument, refused.value.path) == ("rate_hz", path)


def test_csv_is_read_as_the_program_reads_it(tmp_path):
    path = tmp_path / "recording.csv"
    path.write_text("8;30;0;0;1,5;2\n8;30;0;500000;-1;3\n8;30;1;0;7;4\n")
    recording = flankwatch.read(path)
    assert recording.names == ["5", "6"] and recording["5"].samples.tolist() == [1.5, -1.0, 7.0]
    assert (recording[0].rate_hz, recording[0].start_time) == (2.0, None)
    later = flankwatch.read(path, start_time="2026-03-01T09:00:00Z", channels=["6"], unit="g")
    assert later[0].start_time == np.datetime64("2026-03-02T08:30:00") and later[0].unit == "g"
    path.write_text("date,a [g],b\n2026-03-01T08:00:00Z,1,2\n2026-03-01T08:00:00.5Z,3,4\n")
    recording = flankwatch.read(path, unit={"b": "V"})
    assert [channel.unit for channel in recording] == ["g", "V"]
    assert recording[0].start_time == np.datetime64("2026-03-01T08:00:00")
    with pytest.raises(flankwatch.RecordingError, match="rate_hz|sampling rate is 3 Hz, expected 2 Hz"):
        flankwatch.read(path, rate_hz=3.0)
    with pytest.raises(flankwatch.RecordingError, match="time_column is 'a', expected none"):
        flankwatch.read(path, time_column="a")


def test_a_real_gearbox_recording_has_the_samples_of_numpy():
    path = real_data() / "gearbox-spectraquest" / "h30hz0.csv.gz"
    expected = np.loadtxt(path, delimiter=",", skiprows=1, dtype=np.float32)
    recording = flankwatch.read(path, rate_hz=RATE_HZ)
    assert recording.names == ["a1", "a2", "a3", "a4"]
    assert np.array_equal(np.array([channel.samples for channel in recording]).T, expected)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("2026-03-01T08:00:00Z", "2026-03-01T08:00:00"),
        ("2026-03-01 08:00:00.25", "2026-03-01T08:00:00.25"),
        ("2026-03-01T08:00:00+02:00", "2026-03-01T06:00:00"),
        ("2026-03-01T08:00:00.5-0130", "2026-03-01T09:30:00.5"),
        ("2026-03-01", "2026-03-01"),
    ],
)
def test_times_are_utc(tmp_path, text, expected):
    path = tmp_path / "recording.npy"
    np.save(path, np.arange(10.0))
    (channel,) = flankwatch.read(path, start_time=text)
    assert channel.start_time == np.datetime64(expected)


@pytest.mark.parametrize("text", ["noon", "", "Z", "NaT", "2026-13-01", "2026-03-01T08:00:00+2"])
def test_other_texts_are_no_times(tmp_path, text):
    path = tmp_path / "recording.npy"
    np.save(path, np.arange(10.0))
    with pytest.raises(ValueError, match="start_time is .*, expected a time"):
        flankwatch.read(path, start_time=text)


def test_structs_and_matrices_of_matlab_have_names(tmp_path):
    path = tmp_path / "recording.mat"
    x = np.arange(20.0).reshape(10, 2)
    scipy.io.savemat(path, {"rig": {"acc": x, "Fs": 100.0}, "bench": {"note": "none"}})
    recording = flankwatch.read(path)
    assert recording.names == ["rig.acc_1", "rig.acc_2"]
    assert recording["rig.acc_2"].samples.tolist() == x[:, 1].tolist()
    assert recording[0].rate_hz == 100.0
    assert flankwatch.read(path, channels=["rig.acc_2"]).names == ["rig.acc_2"]
    with pytest.raises(ValueError, match="no channel 'acc', expected one of rig.acc_1, rig.acc_2"):
        flankwatch.read(path, channels=["acc"])
    with pytest.raises(KeyError, match="no channel 'acc'"):
        recording["acc"]


@pytest.mark.parametrize("name", ["Zeit [s]", "time", "t_s", "Time (ms)"])
def test_a_time_column_gives_the_rate(tmp_path, name):
    path = tmp_path / "recording.parquet"
    step = 1000 if "ms" in name else 1
    table = pa.table({name: np.arange(100) / 50.0 * step, "acc [m/s2]": np.arange(100.0)})
    pyarrow.parquet.write_table(table, path)
    (channel,) = flankwatch.read(path)
    assert channel.rate_hz == pytest.approx(50.0) and channel.unit == "m/s2"
    assert flankwatch.read(path, rate_hz=50.04)[0].rate_hz == 50.04
    with pytest.raises(ValueError, match="the rate is 51 Hz, expected 50 Hz as in the time column"):
        flankwatch.read(path, rate_hz=51.0)


def test_a_clock_column_gives_rate_and_start(tmp_path):
    path = tmp_path / "recording.parquet"
    start = np.datetime64("2026-03-01T08:00:00", "ns")
    table = pa.table({"when": start + np.arange(10) * np.timedelta64(20, "ms"), "x": np.arange(10.0)})
    pyarrow.parquet.write_table(table, path)
    (channel,) = flankwatch.read(path)
    assert (channel.rate_hz, channel.start_time) == (pytest.approx(50.0), start)


def test_a_time_column_with_a_gap_is_refused(tmp_path):
    path = tmp_path / "recording.parquet"
    time = np.arange(10.0)
    time[6:] += 3
    pyarrow.parquet.write_table(pa.table({"t": time, "x": time}), path)
    with pytest.raises(ValueError, match="steps by 4 s at sample 6"):
        flankwatch.read(path)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "the file is empty"),
        (b"\x89MCAP0\r\n123", "an MCAP recording"),
        (b"\x1f\x8b\x08\x00\x00\x00\x00\x00\x00\x03", "compressed with gzip, without CSV"),
        (b"MIT License\n\nCopyright\n", "csv line 2"),
        (b"\x7fELF\x02\x01", "the file begins with 7f 45 4c 46"),
        (b"\x93NUMPY\x01\x00\xff\xff", "damaged or incomplete .npy file"),
    ],
)
def test_unsupported_files_are_refused(tmp_path, content, message):
    path = tmp_path / "file.bin"
    path.write_bytes(content)
    with pytest.raises(ValueError, match=message):
        flankwatch.read(path)


def test_objects_in_numpy_files_are_refused(tmp_path):
    path = tmp_path / "objects.npy"
    np.save(path, np.array([{"a": 1}], dtype=object), allow_pickle=True)
    with pytest.raises(ValueError, match="allow_pickle"):
        flankwatch.read(path)


@pytest.mark.parametrize(
    ("name", "module", "package"),
    [
        ("mat", "scipy.io", "SciPy"),
        ("tdms", "nptdms", "npTDMS"),
        ("hdf5", "h5py", "h5py"),
        ("parquet", "pyarrow", "pyarrow"),
    ],
)
def test_a_missing_library_is_named(tmp_path, monkeypatch, name, module, package):
    path = tmp_path / "recording"
    WRITERS[name](path, signals(0), 0)
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(ImportError, match=rf"needs {package}.*pip install 'flankwatch\[readers\]'"):
        flankwatch.read(path)
