"""``flankwatch-import``: sends the recordings of a folder to a service."""

from __future__ import annotations

import argparse
import hashlib
import os
import sys
import time as clock
from datetime import datetime, timezone
from pathlib import Path
from typing import Sequence

import httpx

from .client import Client, ServiceError

#: Extensions of the files that are sent.
EXTENSIONS = {
    ".mat",
    ".tdms",
    ".uff",
    ".unv",
    ".h5",
    ".hdf5",
    ".hdf",
    ".parquet",
    ".npy",
    ".npz",
    ".flac",
    ".wav",
    ".mcap",
    ".csv",
}


def argument_parser() -> argparse.ArgumentParser:
    """Returns the parser of the command line."""
    parser = argparse.ArgumentParser(
        prog="flankwatch-import",
        description="Send the recordings of a folder to a flankwatch service. After an interruption, run the "
        "same command again: recordings that the service already has are not stored twice.",
    )
    parser.add_argument(
        "folder", type=Path, help="folder with recordings, searched recursively; or one file"
    )
    parser.add_argument("--asset", required=True, help="asset that the recordings belong to")
    parser.add_argument("--url", default="http://127.0.0.1:8600", help="address of the service")
    parser.add_argument(
        "--token", default=os.environ.get("FLANKWATCH_TOKEN"), help="token; default: FLANKWATCH_TOKEN"
    )
    parser.add_argument("--ca", help="private certificate of the service")
    parser.add_argument("--rate-hz", type=float, help="sampling rate in hertz, for files without one")
    parser.add_argument("--unit", help="unit of the samples")
    parser.add_argument("--channels", help="names of the channels to send, separated by commas")
    parser.add_argument(
        "--shaft-speed-hz", type=float, help="rotational frequency of the driving shaft in hertz"
    )
    parser.add_argument("--torque-nm", type=float, help="torque on the driving shaft in N·m")
    parser.add_argument(
        "--time-pattern",
        help="strptime pattern of the UTC start time in file names without extension: %%Y%%m%%d_%%H%%M%%S",
    )
    return parser


def start_time(path: Path, pattern: str | None) -> str:
    """Returns the time of a file's first sample: from its name, else the time of its last modification."""
    if pattern is None:
        modified = path.stat().st_mtime_ns
        return f"{datetime.fromtimestamp(modified // 10**9, timezone.utc):%Y-%m-%dT%H:%M:%S}.{modified % 10**9:09d}Z"
    try:
        return datetime.strptime(path.stem, pattern).isoformat() + "Z"
    except ValueError as error:
        raise ValueError(f"{path}: the name is {path.stem!r}, expected a time as in {pattern!r}") from error


def idempotency_key(path: Path, options: Sequence[object]) -> str:
    """Returns an idempotency key: the same for the same content with the same options."""
    content = hashlib.sha256(repr(list(options)).encode())
    with path.open("rb") as file:
        while block := file.read(1 << 20):
            content.update(block)
    return content.hexdigest()


def send(client: Client, path: Path, options: argparse.Namespace) -> str:
    """Sends one file. Returns the outcome in words."""
    from .reading import read
    from .reading.detect import detect

    time: str | None = start_time(path, options.time_pattern)
    channels = options.channels.split(",") if options.channels else None
    file_has_time = path.suffix.lower() == ".mcap"
    if not file_has_time and path.suffix.lower() not in (".wav", ".csv") and options.time_pattern is None:
        detect(path)
        times = [
            channel.start_time
            for channel in read(path, channels=channels, rate_hz=options.rate_hz, unit=options.unit)
        ]
        file_has_time = all(known is not None for known in times)
    if file_has_time:
        time = None
    identity = [
        options.asset,
        time,
        channels,
        options.rate_hz,
        options.unit,
        options.shaft_speed_hz,
        options.torque_nm,
    ]
    parameters = {"shaft_speed_hz": options.shaft_speed_hz, "torque_nm": options.torque_nm}
    answer = client.upload_file(
        options.asset,
        path,
        idempotency_key=idempotency_key(path, identity),
        channels=channels,
        rate_hz=options.rate_hz,
        unit=options.unit,
        start_time=time,
        **{name: value for name, value in parameters.items() if value is not None},
    )
    answers = answer.get("uploads", [answer])
    return "already stored" if all(part.get("replayed") for part in answers) else "stored"


def main(argv: Sequence[str] | None = None) -> int:
    """Runs the command. Returns the exit status, 0 if every file was sent."""
    options = argument_parser().parse_args(argv)
    if options.folder.is_dir():
        files = sorted(
            path for path in options.folder.rglob("*") if path.suffix.lower() in EXTENSIONS and path.is_file()
        )
    else:
        files = [options.folder]
    if not files:
        print(
            f"error: no recording in {options.folder}, expected one of {', '.join(sorted(EXTENSIONS))}",
            file=sys.stderr,
        )
        return 1
    failed = 0
    started = clock.monotonic()
    with Client(options.url, options.token, verify=options.ca or True) as client:
        for number, path in enumerate(files, 1):
            try:
                outcome = send(client, path, options)
            except KeyboardInterrupt:
                print(
                    f"stopped after {number - 1} of {len(files)} files; run the same command to continue",
                    file=sys.stderr,
                )
                return 130
            except (ServiceError, ValueError, OSError, ImportError) as error:
                outcome, failed = f"error: {error}", failed + 1
            except httpx.TransportError as error:
                print(f"error: {options.url} cannot be reached: {error}", file=sys.stderr)
                return 1
            remaining_s = (clock.monotonic() - started) / number * (len(files) - number)
            print(f"[{number}/{len(files)}, {remaining_s:.0f} s left] {path}: {outcome}", flush=True)
    if failed:
        print(f"error: {failed} of {len(files)} files were not sent", file=sys.stderr)
    return 1 if failed else 0
