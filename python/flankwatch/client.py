"""A client of the flankwatch service."""

from __future__ import annotations

import hashlib
import json
import time as clock
from pathlib import Path
from typing import Any, Iterator, Mapping, Sequence

import httpx
import numpy as np
from numpy.typing import ArrayLike

from . import uploads
from .connection import Connection, ServiceError, without_none
from .events import Event, parse_events
from .frames import as_frame
from .reading import read
from .reading.guess import as_time
from .recording import Recording


def rfc3339(time: Any) -> str | None:
    """Formats a time as the service writes it."""
    if time is None:
        return None
    if isinstance(time, (int, float)):
        return str(np.datetime64(round(time * 1e9), "ns")) + "Z"
    moment = as_time(time)
    if moment is None:
        raise ValueError(
            f"time is {time!r}, expected an RFC 3339 time, a datetime, a numpy.datetime64 or seconds "
            "since 1970"
        )
    return str(moment) + "Z"


class Client(Connection):
    """A connection to the service at ``url``, with a token if the service requires one.

    Every method that sends a request raises :class:`ServiceError` if the service refuses it, and
    ``httpx.TransportError`` if the service cannot be reached. Rows and dicts have the fields of the HTTP API,
    with units in their names.

    Args:
        url: address of the service.
        token: a token made with ``flankwatch token create``.
        timeout_s: timeout of an answer in seconds.
        repeats: number of retries of a request that the service could not accept.
        verify: ``False`` to accept any certificate, or the path of a private one.
    """

    # Assets

    def assets(self) -> list[dict[str, Any]]:
        """Returns all assets with their summaries."""
        return list(self._pages("/v1/assets", {}))

    def asset(self, asset: str) -> dict[str, Any]:
        """Returns one asset."""
        answer: dict[str, Any] = self.request("GET", f"/v1/assets/{asset}")
        return answer

    def create_asset(self, description: Mapping[str, Any]) -> dict[str, Any]:
        """Creates an asset from its description."""
        answer: dict[str, Any] = self.request("POST", "/v1/assets", json=dict(description))
        return answer

    def replace_asset(self, asset: str, description: Mapping[str, Any]) -> dict[str, Any]:
        """Replaces an asset's description."""
        answer: dict[str, Any] = self.request("PUT", f"/v1/assets/{asset}", json=dict(description))
        return answer

    def delete_asset(self, asset: str) -> None:
        """Deletes an asset with its records."""
        self._send("DELETE", f"/v1/assets/{asset}")

    # Records

    def upload(
        self,
        asset: str,
        x: ArrayLike,
        rate_hz: float,
        *,
        start_time: Any = None,
        unit: str | None = None,
        channel: str | None = None,
        channel_names: Sequence[str] | None = None,
        shaft_speed_hz: float | None = None,
        torque_nm: float | None = None,
        temperature_c: float | None = None,
        reference_wear_um: float | None = None,
        idempotency_key: str | None = None,
    ) -> dict[str, Any]:
        """Sends samples as one record per channel; they are stored in single precision.

        Args:
            asset: the asset's id.
            x: samples, shape ``(n,)`` or ``(channels, n)``.
            rate_hz: sampling rate in hertz.
            start_time: time of the first sample; defaults to the time of receipt.
            unit: unit of the samples.
            channel, channel_names: names of the measuring points.
            shaft_speed_hz: rotational frequency of the driving shaft in hertz.
            torque_nm: torque on the driving shaft in N·m.
            temperature_c: oil or housing temperature in °C.
            reference_wear_um: wear depth in µm from an inspection, which the estimate does not use.
            idempotency_key: uploads with the same key are stored once; defaults to a hash of the content if a
                start time is given.

        Returns:
            The segment, or ``{"segments": [...]}`` for several channels.

        Raises:
            ValueError: if samples are not finite or not of these shapes, or the time is not one.
        """
        samples = np.atleast_2d(np.asarray(x))
        if samples.ndim != 2 or samples.dtype.kind not in "fiu":
            raise ValueError(
                f"x has shape {np.shape(x)} and type {samples.dtype}, expected real numbers of shape (n,) "
                "or (channels, n)"
            )
        if not np.all(np.isfinite(samples)):
            raise ValueError(
                f"x has {np.count_nonzero(~np.isfinite(samples))} samples that are not finite, expected none"
            )
        body = np.ascontiguousarray(samples.T, dtype="<f4").tobytes()
        parameters = without_none(
            {
                "sample": "f32",
                "sample_rate_hz": repr(float(rate_hz)),
                "channels": len(samples),
                "start_time": rfc3339(start_time),
                "unit": unit,
                "channel": channel,
                "channel_names": ",".join(channel_names) if channel_names else None,
                "shaft_speed_hz": shaft_speed_hz,
                "torque_nm": torque_nm,
                "temperature_c": temperature_c,
                "reference_wear_um": reference_wear_um,
            }
        )
        return self._upload(asset, body, "application/octet-stream", parameters, idempotency_key)

    def upload_file(
        self,
        asset: str,
        path: str | Path,
        *,
        idempotency_key: str | None = None,
        channels: Sequence[str] | None = None,
        rate_hz: float | None = None,
        unit: str | None = None,
        start_time: Any = None,
        scale: float | None = None,
        sensitivity_mv_per_g: float | None = None,
        **parameters: Any,
    ) -> dict[str, Any]:
        """Sends a recording in a file.

        MCAP is sent unchanged, and so are WAV and CSV (also ``.csv.gz``) if neither channels nor a scale are
        given. Others are sent as :func:`flankwatch.read` reads them.

        Args:
            asset: the asset's id.
            path: the file.
            idempotency_key: uploads with the same key are stored once.
            channels: names of the channels to send.
            rate_hz: sampling rate in hertz of a file without one.
            unit: unit of the samples.
            start_time: time of the first sample of a file without one. Times of day in a CSV file count from
                it on.
            scale: factor of the values; full-scale integers of WAV and FLAC are 1 before.
            sensitivity_mv_per_g: sensor sensitivity in mV/g: converts values in volts (after ``scale``) to g.
            parameters: as for :meth:`upload`, such as ``shaft_speed_hz``.

        Returns:
            The answer to the upload, or ``{"uploads": [...]}`` for several uploads.

        Raises:
            RecordingError: if the file is damaged, or an argument does not fit it.
            ServiceError: if the service refuses it.
        """
        path = Path(path)
        if sensitivity_mv_per_g is not None and unit not in (None, "g"):
            raise ValueError(f'unit is {unit!r}, expected None or "g" with sensitivity_mv_per_g')
        arguments = {
            "channels": channels,
            "rate_hz": rate_hz,
            "unit": unit,
            "start_time": start_time,
            "scale": scale,
            "sensitivity_mv_per_g": sensitivity_mv_per_g,
            **parameters,
        }
        name = uploads.format_of(path)
        if name == "mcap":
            uploads.check_mcap(path, arguments)
            return self._upload(asset, path.read_bytes(), uploads.MEDIA_TYPES[name], {}, idempotency_key)
        is_read = channels is not None or scale is not None or sensitivity_mv_per_g is not None
        if name in ("wav", "csv") and not is_read:
            return self._upload_unchanged(
                asset, path, name, rate_hz, start_time, {"unit": unit, **parameters}, idempotency_key
            )
        recording = read(
            path,
            channels=channels,
            rate_hz=rate_hz,
            unit=None if sensitivity_mv_per_g is not None else unit,
            start_time=start_time,
        )
        return self.upload_recording(
            asset,
            recording,
            idempotency_key=idempotency_key,
            scale=scale,
            sensitivity_mv_per_g=sensitivity_mv_per_g,
            **parameters,
        )

    def _upload_unchanged(
        self,
        asset: str,
        path: Path,
        name: str,
        rate_hz: float | None,
        start_time: Any,
        parameters: Mapping[str, Any],
        key: str | None,
    ) -> dict[str, Any]:
        query = dict(parameters)
        if name == "wav" and rate_hz is not None:
            uploads.header(path, rate_hz)
        if name == "csv" and rate_hz is not None:
            query["sample_rate_hz"] = repr(float(rate_hz))
        if start_time is not None:
            query["start_time"] = rfc3339(start_time)
            if name == "csv":
                query["start_time"] = uploads.start_time(path, rate_hz, query["start_time"])
        return self._upload(asset, path.read_bytes(), uploads.MEDIA_TYPES[name], without_none(query), key)

    def upload_recording(
        self,
        asset: str,
        recording: Recording,
        *,
        idempotency_key: str | None = None,
        scale: float | None = None,
        sensitivity_mv_per_g: float | None = None,
        **parameters: Any,
    ) -> dict[str, Any]:
        """Sends a recording as :func:`flankwatch.read` returns it.

        Channels of the same rate, unit, start and length are sent together. The arguments are those of
        :meth:`upload_file`.

        Returns:
            The answer to the upload, or ``{"uploads": [...]}`` for several uploads.

        Raises:
            RecordingError: if a channel has no rate, or is not in volts although a sensitivity is given.
            ServiceError: if the service refuses it.
        """
        answers = []
        recording = uploads.scaled(recording, scale, sensitivity_mv_per_g)
        for number, group in enumerate(uploads.groups(recording)):
            first = group[0]
            names = [channel.name.replace(",", " ") for channel in group]
            key = idempotency_key if number == 0 or idempotency_key is None else f"{idempotency_key}-{number}"
            answers.append(
                self.upload(
                    asset,
                    np.stack([channel.samples for channel in group]),
                    first.rate_hz or 0.0,
                    start_time=first.start_time,
                    unit=first.unit,
                    channel=names[0] if len(names) == 1 else None,
                    channel_names=names if len(names) > 1 else None,
                    idempotency_key=key,
                    **parameters,
                )
            )
        return answers[-1] if len(answers) == 1 else {"uploads": answers}

    def _upload(
        self, asset: str, body: bytes, media_type: str, parameters: Mapping[str, Any], key: str | None
    ) -> dict[str, Any]:
        headers = {"content-type": media_type}
        if media_type == "text/csv" and body.startswith(b"\x1f\x8b"):
            headers["content-encoding"] = "gzip"
        if key is None and "start_time" in parameters:
            content = hashlib.sha256(
                json.dumps([asset, media_type, dict(parameters)], sort_keys=True).encode()
            )
            content.update(body)
            key = content.hexdigest()
        if key is not None:
            headers["idempotency-key"] = key
        response = self._send(
            "POST", f"/v1/assets/{asset}/segments", content=body, headers=headers, params=dict(parameters)
        )
        answer: dict[str, Any] = response.json()
        if response.headers.get("idempotency-replayed") == "true":
            answer["replayed"] = True
        return answer

    def segments(self, asset: str, **parameters: Any) -> Iterator[dict[str, Any]]:
        """Returns the records of an asset in time order; ``channel``, ``order``, ``operating_bin``."""
        return self._pages(f"/v1/assets/{asset}/segments", parameters)

    def segment(self, segment: str) -> dict[str, Any]:
        """Returns one record with its indicators and its wear estimate."""
        answer: dict[str, Any] = self.request("GET", f"/v1/segments/{segment}")
        return answer

    def waveform(self, segment: str, **parameters: Any) -> dict[str, Any]:
        """Returns the samples of a record in its unit: a dict with ``value``, a list of numbers.

        ``max_points`` reduces each interval to its minimum and maximum; ``from_s`` and ``to_s`` select a part.
        """
        answer: dict[str, Any] = self.request("GET", f"/v1/segments/{segment}/waveform", params=parameters)
        return answer

    # Wear and trends

    def wear(self, asset: str) -> dict[str, Any]:
        """Returns the latest wear estimate: a dict with ``status`` and depths in µm."""
        answer: dict[str, Any] = self.request("GET", f"/v1/assets/{asset}/wear")
        return answer

    def wear_history(self, asset: str, *, frame: str | None = None, **parameters: Any) -> Any:
        """Returns the wear over time: a list of rows, or a frame for ``frame="pandas"`` or ``"polars"``."""
        return as_frame(self.request("GET", f"/v1/assets/{asset}/wear/history", params=parameters), frame)

    def trend(self, asset: str, names: Sequence[str], *, frame: str | None = None, **parameters: Any) -> Any:
        """Returns indicators over time; ``channel``, ``from``, ``to``, ``max_points``.

        ``frame`` is as for :meth:`wear_history`.
        """
        parameters["names"] = ",".join(names)
        return as_frame(self.request("GET", f"/v1/assets/{asset}/indicators", params=parameters), frame)

    # Replays

    def start_replay(self, asset: str, file: str, *, pace: str = "max") -> dict[str, Any]:
        """Starts a replay of a recording in the service's folder.

        ``pace`` is ``"max"``, ``"realtime"`` or a factor such as ``"10x"``.
        """
        answer: dict[str, Any] = self.request(
            "POST", "/v1/replays", json={"asset": asset, "file": file, "pace": pace}
        )
        return answer

    def replays(self) -> list[dict[str, Any]]:
        """Returns all replays."""
        return list(self._pages("/v1/replays", {}))

    def replay(self, replay: str) -> dict[str, Any]:
        """Returns one replay with its progress."""
        answer: dict[str, Any] = self.request("GET", f"/v1/replays/{replay}")
        return answer

    def stop_replay(self, replay: str) -> None:
        """Stops a replay."""
        self._send("DELETE", f"/v1/replays/{replay}")

    # Events

    def events(
        self, asset: str | None = None, *, last_event_id: str | None = None, reconnect: bool = True
    ) -> Iterator[Event]:
        """Iterates over events as they happen, and resumes after a lost connection.

        The iterator waits for the next event. It does not end while ``reconnect`` is true.
        """
        while True:
            headers = without_none({"accept": "text/event-stream", "last-event-id": last_event_id})
            try:
                with self._http.stream(
                    "GET", "/v1/events", params=without_none({"asset": asset}), headers=headers, timeout=None
                ) as response:
                    if response.status_code >= 400:
                        response.read()
                        raise ServiceError(response.status_code, {"detail": response.text})
                    for event in parse_events(response.iter_lines()):
                        last_event_id = event.id or last_event_id
                        yield event
            except httpx.TransportError:
                if not reconnect:
                    raise
            if not reconnect:
                return
            clock.sleep(1.0)
