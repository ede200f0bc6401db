"""``flankwatch-import``: sends the recordings of a folder to a service."""

from __future__ import annotations

import argparse
import hashlib
import os
import sys
import time as clock
from datetime import datetime, timezone
from pathlib import Path
from typing import Any, Sequence

import httpx
import numpy as np

from . import uploads
from .client import Client, rfc3339
from .connection import ServiceError
from .import_state import FILE_NAME, ImportState
from .reading import read
from .reading.guess import as_time
from .recording import Recording, RecordingError, argument_error

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
    ".csv.gz",
}

#: Options that describe the recordings, named as the arguments of :meth:`Client.upload_file`.
RECORDING_OPTIONS = (
    "channels",
    "rate_hz",
    "unit",
    "scale",
    "sensitivity_mv_per_g",
    "shaft_speed_hz",
    "torque_nm",
)


def argument_parser() -> argparse.ArgumentParser:
    """Returns the parser of the command line."""
    parser = argparse.ArgumentParser(
        prog="flankwatch-import",
        description="Send the recordings of a folder to a flankwatch service. After an interruption, run the "
        "same command again: it continues with the files that were not sent.",
    )
    parser.add_argument("folder", type=Path, help="folder with recordings, searched recursively; or one file")
    parser.add_argument("--asset", required=True, help="asset that the recordings belong to")
    parser.add_argument("--url", default="http://127.0.0.1:8600", help="address of the service")
    parser.add_argument(
        "--token", default=os.environ.get("FLANKWATCH_TOKEN"), help="token; default: FLANKWATCH_TOKEN"
    )
    parser.add_argument("--ca", help="private certificate of the service")
    parser.add_argument("--rate-hz", type=float, help="sampling rate in hertz, for files without one")
    parser.add_argument("--unit", help="unit of the samples")
    parser.add_argument(
        "--scale", type=float, help="factor of the values; full-scale WAV and FLAC integers are 1 before"
    )
    parser.add_argument(
        "--sensitivity-mv-per-g",
        type=float,
        help="sensor sensitivity in mV/g: converts values in volts (after --scale) to g",
    )
    parser.add_argument("--channels", help="names of the channels to send, separated by commas")
    parser.add_argument(
        "--shaft-speed-hz", type=float, help="rotational frequency of the driving shaft in hertz"
    )
    parser.add_argument("--torque-nm", type=float, help="torque on the driving shaft in N·m")
    parser.add_argument(
        "--time-pattern",
        help="strptime pattern of the start time in file names without extension, in UTC unless it has %%z: "
        "%%Y%%m%%d_%%H%%M%%S",
    )
    parser.add_argument(
        "--start-time",
        help="time of the first sample of recordings without one, which follow one another in order of their "
        "names; times of day in CSV files count from it on",
    )
    parser.add_argument(
        "--state", type=Path, help=f"file that records what was sent; default: {FILE_NAME} in the folder"
    )
    return parser


def time_in_name(path: Path, pattern: str) -> str:
    """Returns the start time in a file's name."""
    name = path.name.lower()
    stem = path.name[: -len(".csv.gz")] if name.endswith(".csv.gz") else path.stem
    try:
        moment = datetime.strptime(stem, pattern)
        if moment.tzinfo is not None:
            moment = moment.astimezone(timezone.utc).replace(tzinfo=None)
    except (ValueError, OverflowError) as error:
        raise RecordingError(path, f"the name is {stem!r}, expected a time as in {pattern!r}") from error
    return moment.isoformat() + "Z"


def modification_time(path: Path) -> str:
    """Returns the time of a file's last modification."""
    return f"{np.datetime64(path.stat().st_mtime_ns, 'ns')}Z"


def idempotency_key(path: Path, options: Sequence[object]) -> str:
    """Returns an idempotency key: the same for the same content with the same options."""
    content = hashlib.sha256(repr(list(options)).encode())
    with path.open("rb") as file:
        while block := file.read(1 << 20):
            content.update(block)
    return content.hexdigest()


def end_ns(start: Any, samples: int, rate_hz: float | None) -> int | None:
    """Returns the end of a recording in nanoseconds since 1970."""
    moment = as_time(start)
    if moment is None or not rate_hz:
        return None
    return int(moment.astype("datetime64[ns]").astype(np.int64)) + round(samples / rate_hz * 1e9)


class Importer:
    """Sends the files of a folder, in order.

    ``next_start`` is the time of the first sample of the next recording without one: the end of those before
    it, if a start time was given.
    """

    def __init__(self, client: Client, options: argparse.Namespace) -> None:
        self.client = client
        self.asset: str = options.asset
        self.pattern: str | None = options.time_pattern
        self.next_start: str | None = options.start_time
        self.values = {name: getattr(options, name) for name in RECORDING_OPTIONS}
        if options.channels is not None:
            self.values["channels"] = options.channels.split(",")

    def follow(self, end: int | None) -> None:
        """Continues after a recording that ends at ``end``."""
        if self.next_start is not None and end is not None:
            start = as_time(self.next_start)
            if start is None or np.datetime64(end, "ns") > start:
                self.next_start = f"{np.datetime64(end, 'ns')}Z"

    def send(self, path: Path) -> tuple[str, int | None]:
        """Sends one file. Returns the outcome in words, and the end of its samples."""
        name = uploads.format_of(path)
        given = time_in_name(path, self.pattern) if self.pattern is not None else self.next_start
        if name == "mcap":
            return self.upload(path, None, None), None
        if name in ("wav", "csv"):
            return self.send_frames(path, name, given)
        values = self.values
        recording = read(
            path,
            channels=values["channels"],
            rate_hz=values["rate_hz"],
            unit=None if values["sensitivity_mv_per_g"] is not None else values["unit"],
            start_time=given if self.pattern is not None else None,
        )
        for channel in recording:
            if channel.start_time is None:
                channel.start_time = as_time(given or modification_time(path))
        ends = [
            end_ns(channel.start_time, channel.samples.size, channel.rate_hz) or 0 for channel in recording
        ]
        starts = [rfc3339(channel.start_time) for channel in recording]
        return self.upload(path, recording, starts), max(ends)

    def send_frames(self, path: Path, name: str, given: str | None) -> tuple[str, int | None]:
        """Sends a WAV or CSV file."""
        found = uploads.header(path, self.values["rate_hz"])
        start = given
        if found["states"] == "date":
            start = found["start_time"]
        elif found["states"] == "time of day":
            if given is None:
                expected = "a time from which the file's times of day count"
                raise argument_error(path, "start_time", "missing", expected)
            start = uploads.start_time(path, self.values["rate_hz"], given)
        elif start is None:
            start = modification_time(path)
        outcome = self.upload(path, None, start)
        return outcome, end_ns(start, found["frames"], found["rate_hz"])

    def upload(self, path: Path, recording: Recording | None, start: Any) -> str:
        """Uploads a file, or what was read from it. Returns the outcome in words."""
        arguments = dict(self.values)
        key = idempotency_key(path, [self.asset, start, arguments])
        if recording is None:
            arguments = {name: value for name, value in arguments.items() if value is not None}
            answer = self.client.upload_file(
                self.asset, path, idempotency_key=key, start_time=start, **arguments
            )
        else:
            for name in ("channels", "rate_hz", "unit"):
                del arguments[name]
            answer = self.client.upload_recording(self.asset, recording, idempotency_key=key, **arguments)
        answers = answer.get("uploads", [answer])
        return "already stored" if all(part.get("replayed") for part in answers) else "stored"


def files_in(folder: Path) -> list[Path]:
    """Returns the recordings in a folder in order of their paths, or the file itself."""
    if not folder.is_dir():
        return [folder]
    found = (path for path in folder.rglob("*") if path.name.lower().endswith(tuple(EXTENSIONS)))
    return sorted(path for path in found if path.is_file())


def explain(error: Exception) -> str:
    """Returns an error in words, with the option in place of the argument at fault."""
    if not isinstance(error, RecordingError):
        return str(error)
    if error.argument is None:
        return error.detail
    option = f"--{error.argument.replace('_', '-')}"
    if error.argument in error.detail:
        return error.detail.replace(error.argument, option, 1)
    return f"{option}: {error.detail}"


def check(options: argparse.Namespace) -> None:
    """Raises ``ValueError`` for options that are invalid for every file."""
    if options.start_time is not None and as_time(options.start_time) is None:
        raise ValueError(f"--start-time is {options.start_time!r}, expected an RFC 3339 time")
    try:
        uploads.scale_factor(options.scale, options.sensitivity_mv_per_g)
    except ValueError as error:
        raise ValueError(f"--{str(error).replace('_', '-')}") from error
    if options.sensitivity_mv_per_g is not None and options.unit not in (None, "g"):
        raise ValueError(
            f"--unit is {options.unit!r}, expected none with --sensitivity-mv-per-g, which gives g"
        )


def main(argv: Sequence[str] | None = None) -> int:
    """Runs the command. Returns the exit status, 0 if every file was sent."""
    options = argument_parser().parse_args(argv)
    files = files_in(options.folder)
    root = options.folder if options.folder.is_dir() else options.folder.parent
    destination = [options.url, options.asset, options.time_pattern, options.start_time]
    destination += [getattr(options, name) for name in RECORDING_OPTIONS]
    try:
        check(options)
        if not files:
            expected = ", ".join(sorted(EXTENSIONS))
            raise ValueError(f"no recording in {options.folder}, expected one of {expected}")
        state = ImportState(options.state or root / FILE_NAME, destination)
    except OSError as error:
        print(f"error: the state file cannot be written, expected --state FILE: {error}", file=sys.stderr)
        return 1
    except ValueError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    with state:
        try:
            client = Client(options.url, options.token, verify=options.ca or True)
        except OSError as error:
            print(f"error: --ca is {options.ca}, expected a PEM file: {error}", file=sys.stderr)
            return 1
        with client:
            return send_all(Importer(client, options), state, files, root)


def send_all(importer: Importer, state: ImportState, files: Sequence[Path], root: Path) -> int:
    """Sends the files that were not sent before, and shows the progress. Returns the exit status."""
    failed = 0
    started = clock.monotonic()
    for number, path in enumerate(files, 1):
        try:
            name, found = path.relative_to(root).as_posix(), path.stat()
            sent = state.sent(name, found)
            if sent is not None:
                outcome, end = "sent before", sent.end_ns
            else:
                outcome, end = importer.send(path)
                state.add(name, found, end)
            importer.follow(end)
        except KeyboardInterrupt:
            print(
                f"stopped after {number - 1} of {len(files)} files; run the same command to continue",
                file=sys.stderr,
            )
            return 130
        except (ServiceError, ValueError, OSError, ImportError) as error:
            outcome, failed = f"error: {explain(error)}", failed + 1
        except httpx.TransportError as error:
            print(f"error: {importer.client.url} cannot be reached: {error}", file=sys.stderr)
            return 1
        remaining_s = (clock.monotonic() - started) / number * (len(files) - number)
        print(f"[{number}/{len(files)}, {remaining_s:.0f} s left] {path}: {outcome}", flush=True)
    if failed:
        print(f"error: {failed} of {len(files)} files were not sent", file=sys.stderr)
    return 1 if failed else 0
