"""``flankwatch-import``: the recordings of a folder, sent to a service."""

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

#: Endings of files that are looked at.
ENDINGS = {
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


def arguments() -> argparse.ArgumentParser:
    """The arguments of the command."""
    parser = argparse.ArgumentParser(
        prog="flankwatch-import",
        description="Send the recordings of a folder to a flankwatch service. The same command goes on after a stop: "
        "what the service has already is not stored twice.",
    )
    parser.add_argument(
        "folder", type=Path, help="folder with recordings, searched with all folders in it; or one file"
    )
    parser.add_argument("--asset", required=True, help="asset that they belong to")
    parser.add_argument("--url", default="http://127.0.0.1:8600", help="address of the service")
    parser.add_argument(
        "--token", default=os.environ.get("FLANKWATCH_TOKEN"), help="token; else that of FLANKWATCH_TOKEN"
    )
    parser.add_argument("--ca", help="private certificate of the service")
    parser.add_argument("--rate-hz", type=float, help="sampling rate in hertz, where files do not say")
    parser.add_argument("--unit", help="unit of the samples")
    parser.add_argument("--channels", help="names of the channels to send, with commas between them")
    parser.add_argument(
        "--shaft-speed-hz", type=float, help="rotational frequency of the driving shaft in hertz"
    )
    parser.add_argument("--torque-nm", type=float, help="torque on the driving shaft in N·m")
    parser.add_argument(
        "--time-pattern",
        help="how a file's name without its ending says the UTC time of its first sample, as in strptime: %%Y%%m%%d_%%H%%M%%S",
    )
    return parser


def start_time(path: Path, pattern: str | None) -> str:
    """The time of a file's first sample: by its name, else when it was last written."""
    if pattern is None:
        written = path.stat().st_mtime_ns
        return f"{datetime.fromtimestamp(written // 10**9, timezone.utc):%Y-%m-%dT%H:%M:%S}.{written % 10**9:09d}Z"
    try:
        return datetime.strptime(path.stem, pattern).isoformat() + "Z"
    except ValueError as error:
        raise ValueError(f"{path}: the name is {path.stem!r}, expected a time as in {pattern!r}") from error


def key_of(path: Path, options: Sequence[object]) -> str:
    """A key that is the same for the same content sent in the same way."""
    content = hashlib.sha256(repr(list(options)).encode())
    with path.open("rb") as file:
        while block := file.read(1 << 20):
            content.update(block)
    return content.hexdigest()


def send(client: Client, path: Path, options: argparse.Namespace) -> str:
    """Sends one file; answers with what became of it in words."""
    from .reading import read
    from .reading.detect import detect

    when: str | None = start_time(path, options.time_pattern)
    channels = options.channels.split(",") if options.channels else None
    said_by_file = path.suffix.lower() == ".mcap"
    if not said_by_file and path.suffix.lower() not in (".wav", ".csv") and options.time_pattern is None:
        detect(path)
        said = [
            channel.start_time
            for channel in read(path, channels=channels, rate_hz=options.rate_hz, unit=options.unit)
        ]
        said_by_file = all(time is not None for time in said)
    if said_by_file:
        when = None
    sent = [
        options.asset,
        when,
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
        idempotency_key=key_of(path, sent),
        channels=channels,
        rate_hz=options.rate_hz,
        unit=options.unit,
        start_time=when,
        **{name: value for name, value in parameters.items() if value is not None},
    )
    answers = answer.get("uploads", [answer])
    return "was there already" if all(part.get("replayed") for part in answers) else "stored"


def main(argv: Sequence[str] | None = None) -> int:
    """Runs the command; the exit status is 0 where every file was sent."""
    options = arguments().parse_args(argv)
    if options.folder.is_dir():
        files = sorted(
            path for path in options.folder.rglob("*") if path.suffix.lower() in ENDINGS and path.is_file()
        )
    else:
        files = [options.folder]
    if not files:
        print(
            f"error: no recording in {options.folder}, expected files that end with {', '.join(sorted(ENDINGS))}",
            file=sys.stderr,
        )
        return 1
    failed = 0
    begun = clock.monotonic()
    with Client(options.url, options.token, verify=options.ca or True) as client:
        for number, path in enumerate(files, 1):
            try:
                outcome = send(client, path, options)
            except KeyboardInterrupt:
                print(
                    f"stopped after {number - 1} of {len(files)} files; the same command goes on",
                    file=sys.stderr,
                )
                return 130
            except (ServiceError, ValueError, OSError, ImportError) as error:
                outcome, failed = f"error: {error}", failed + 1
            except httpx.TransportError as error:
                print(f"error: {options.url} cannot be reached: {error}", file=sys.stderr)
                return 1
            left_s = (clock.monotonic() - begun) / number * (len(files) - number)
            print(f"[{number}/{len(files)}, {left_s:.0f} s left] {path}: {outcome}", flush=True)
    if failed:
        print(f"error: {failed} of {len(files)} files were not sent", file=sys.stderr)
    return 1 if failed else 0
