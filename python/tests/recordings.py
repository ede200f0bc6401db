"""Recordings of each format, written by the format's own library."""

from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np
import pyarrow as pa
import pyarrow.parquet
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
    with path.open("wb") as file:
        np.save(file, np.asfortranarray(rows) if number % 3 else rows)


def write_flac(path: Path, x: dict[str, np.ndarray], number: int) -> None:
    samples = np.array([np.clip(x_of / np.abs(x_of).max(), -1, 0.999) for x_of in x.values()]).T
    soundfile.write(path, samples, int(RATE_HZ), format="FLAC", subtype="PCM_24" if number % 2 else "PCM_16")


def write_npz(path: Path, x: dict[str, np.ndarray], number: int) -> None:
    with path.open("wb") as file:
        (np.savez_compressed if number % 2 else np.savez)(file, **x, fs=RATE_HZ, unit="g")


SUBTYPES = ["FLOAT", "PCM_16", "PCM_24", "PCM_32", "DOUBLE", "PCM_U8"]


def write_wav(path: Path, x: dict[str, np.ndarray], number: int) -> None:
    samples = np.array([np.clip(x_of / np.abs(x_of).max(), -1, 0.999) for x_of in x.values()]).T
    soundfile.write(path, samples, int(RATE_HZ), format="WAV", subtype=SUBTYPES[number % len(SUBTYPES)])


def write_csv(path: Path, x: dict[str, np.ndarray], number: int) -> None:
    lines = [f"{a1!s};{a2!s}\n" for a1, a2 in zip(*(samples.astype(np.float32) for samples in x.values()))]
    path.write_text(f"Sample rate;{RATE_HZ}\na1 [g];a2 [g]\n" + "".join(lines))


#: Formats that contain names, rate and unit.
WRITERS = {
    "mat": write_mat,
    "mat73": write_mat73,
    "hdf5": write_hdf5,
    "tdms": write_tdms,
    "uff": write_uff,
    "parquet": write_parquet,
    "npz": write_npz,
    "csv": write_csv,
}

#: All formats.
ALL_WRITERS = {**WRITERS, "npy": write_npy, "flac": write_flac, "wav": write_wav}
