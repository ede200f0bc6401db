"""Each reader returns the samples written by another library, in ten files per format."""

from __future__ import annotations

import datetime
import sys
from pathlib import Path

import flankwatch
import h5py
import numpy as np
import pyarrow as pa
import pyarrow.parquet
import pytest
import pyuff
import scipy.io
import soundfile
from nptdms import ChannelObject, GroupObject, RootObject, TdmsWriter

RATE_HZ = 12_800.0
TYPES = [np.float64, np.float32, np.int16, np.int32]


def signals(number: int) -> dict[str, np.ndarray]:
    """Two channels whose type and length depend on the number."""
    rng = np.random.default_rng(number)
    kind = TYPES[number % len(TYPES)]
    count = 50 + 37 * number
    values = rng.normal(size=(2, count)) * (1000 if kind in (np.int16, np.int32) else 1)
    return {"a1": values[0].astype(kind), "a2": values[1].astype(kind)}


def write_mat(path: Path, x: dict[str, np.ndarray], number: int) -> None:
    content = {**x, "fs": RATE_HZ, "unit": "g"}
    scipy.io.savemat(
        path, content, do_compression=bool(number % 2), oned_as="column" if number % 3 else "row"
    )


def write_mat73(path: Path, x: dict[str, np.ndarray], number: int) -> None:
    """Writes as MATLAB does: HDF5 after a block of 512 bytes, axes reversed, text as numbers."""
    with h5py.File(path, "w", userblock_size=512) as file:
        for name, samples in x.items():
            dataset = file.create_dataset(
                name, data=samples.reshape(1, -1), compression="gzip" if number % 2 else None
            )
            dataset.attrs["MATLAB_class"] = np.bytes_("double")
        file.create_dataset("fs", data=[[RATE_HZ]]).attrs["MATLAB_class"] = np.bytes_("double")
        text = file.create_dataset("unit", data=np.array([[ord("g")]], dtype="u2"))
        text.attrs["MATLAB_class"] = np.bytes_("char")
    with path.open("r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(116) + b"\0" * 8 + b"\x00\x02IM")


def write_hdf5(path: Path, x: dict[str, np.ndarray], number: int) -> None:
    with h5py.File(path, "w") as file:
        group = file.create_group("measurement")
        group.attrs["sample_rate"] = RATE_HZ
        for name, samples in x.items():
            group.create_dataset(name, data=samples, chunks=True if number % 2 else None).attrs["unit"] = "g"


def write_tdms(path: Path, x: dict[str, np.ndarray], number: int) -> None:
    start = np.datetime64("2026-03-01T08:00:00.25")
    with TdmsWriter(path) as writer:
        parts = np.array_split(np.arange(x["a1"].size), 1 + number % 3)
        for part in parts:
            properties = {"wf_increment": 1 / RATE_HZ, "unit_string": "g", "wf_start_time": start}
            channels = [
                ChannelObject("vibration", name, samples[part], properties=properties)
                for name, samples in x.items()
            ]
            writer.write_segment([RootObject(), GroupObject("vibration"), *channels])


def write_uff(path: Path, x: dict[str, np.ndarray], number: int) -> None:
    sets = []
    for node, (name, samples) in enumerate(x.items(), 1):
        dataset = pyuff.prepare_58(
            binary=number % 2,
            func_type=1,
            rsp_node=node,
            rsp_dir=3,
            ref_node=0,
            ref_dir=0,
            rsp_ent_name=name,
            data=samples.astype(float),
            x=np.arange(samples.size) / RATE_HZ,
            abscissa_inc=1 / RATE_HZ,
            abscissa_spacing=1,
            abscissa_min=0.0,
            num_pts=samples.size,
            ord_data_type=4,
            id1=name,
            ordinate_axis_units_lab="g",
            return_full_dict=True,
        )
        texts = ("id", "rsp_ent", "ref_ent")
        empty = {
            key: "NONE" if key.startswith(texts) or key.endswith("_lab") else 0
            for key, value in dataset.items()
            if value is None
        }
        sets.append(dataset | empty)
    path.unlink(missing_ok=True)
    pyuff.UFF(str(path)).write_sets(sets, "add")


def write_parquet(path: Path, x: dict[str, np.ndarray], number: int) -> None:
    fields = [
        pa.field(name, pa.from_numpy_dtype(samples.dtype), metadata={"unit": "g"})
        for name, samples in x.items()
    ]
    schema = pa.schema(fields, metadata={"sample_rate_hz": str(RATE_HZ)})
    table = pa.table(list(x.values()), schema=schema)
    pyarrow.parquet.write_table(
        table, path, compression=["zstd", "snappy", "none"][number % 3], row_group_size=64
    )


def write_npy(path: Path, x: dict[str, np.ndarray], number: int) -> None:
    rows = np.array(list(x.values())) if number % 2 else np.array(list(x.values())).T
    np.save(path, np.asfortranarray(rows) if number % 3 else rows)


def write_flac(path: Path, x: dict[str, np.ndarray], number: int) -> None:
    samples = np.array([np.clip(x_of / np.abs(x_of).max(), -1, 0.999) for x_of in x.values()]).T
    soundfile.write(path, samples, int(RATE_HZ), format="FLAC", subtype="PCM_24" if number % 2 else "PCM_16")


WRITERS = {
    "mat": write_mat,
    "mat73": write_mat73,
    "hdf5": write_hdf5,
    "tdms": write_tdms,
    "uff": write_uff,
    "parquet": write_parquet,
}


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
        expected = samples
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


@pytest.mark.parametrize("name", [*WRITERS, "npy", "flac"])
def test_truncated_files_are_refused_by_name(tmp_path, name):
    path = tmp_path / f"recording.{name}"
    write = {"npy": write_npy, "flac": write_flac, **WRITERS}[name]
    write(path, signals(1 if name == "uff" else 8), 1 if name == "uff" else 8)
    whole = path.read_bytes()
    for part in (len(whole) // 8, len(whole) // 2):
        path.write_bytes(whole[:part])
        try:
            cut = flankwatch.read(path, rate_hz=RATE_HZ)
        except ValueError as error:
            assert str(path) in str(error)
        else:
            # Segmented formats may end after any segment.
            assert all(channel.samples.size <= 346 for channel in cut)


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
