"""The client's requests against the service's own description, with tokens, and over lost connections."""

from __future__ import annotations

import contextlib
import re
import socket
import subprocess
import threading
import time
from collections.abc import Iterator

import flankwatch
import httpx
import numpy as np
import pytest
import soundfile

from conftest import gear_signal, serve
from test_docstrings import methods

RATE_HZ = 20_000.0


def calls(tmp_path) -> dict[str, object]:
    """A call of each method that sends a request."""
    wav, mcap, csv = (tmp_path / f"recording.{end}" for end in ("wav", "mcap", "csv"))
    soundfile.write(wav, gear_signal()[:100], 20_000)
    mcap.write_bytes(b"\x89MCAP0\r\n")
    csv.write_text("1\n2\n3\n")
    x = [1.0, 2.0, 3.0]
    point = {"shaft_speed_hz": 25.0, "torque_nm": 1.0, "temperature_c": 20.0, "reference_wear_um": 1.0}

    def upload_file(client):
        client.upload_file("a", wav, unit="g", start_time=0, **point)
        client.upload_file("a", mcap)
        client.upload_file("a", csv, rate_hz=100.0)
        client.upload_file("a", csv, rate_hz=100.0, channels=["1"], scale=2.0)

    def upload(client):
        client.upload("a", [x, x], 1.0, start_time=0, unit="g", channel_names=["in", "out"], **point)
        client.upload("a", x, 1.0, channel="in", idempotency_key="key")

    return {
        "assets": lambda client: client.assets(),
        "asset": lambda client: client.asset("a"),
        "create_asset": lambda client: client.create_asset({"id": "a"}),
        "replace_asset": lambda client: client.replace_asset("a", {"id": "a"}),
        "delete_asset": lambda client: client.delete_asset("a"),
        "upload": upload,
        "upload_file": upload_file,
        "upload_recording": lambda client: client.upload_recording("a", flankwatch.read(csv, rate_hz=1.0)),
        "segments": lambda client: list(client.segments("a", channel="1", order="desc", operating_bin=0)),
        "segment": lambda client: client.segment("s"),
        "waveform": lambda client: client.waveform("s", max_points=9, from_s=0.0, to_s=1.0),
        "wear": lambda client: client.wear("a"),
        "wear_history": lambda client: client.wear_history("a", channel="1", max_points=9),
        "trend": lambda client: client.trend("a", ["rms"], channel="1", **{"from": 0, "to": 1}, max_points=9),
        "start_replay": lambda client: client.start_replay("a", "run.wav", pace="10x"),
        "replays": lambda client: client.replays(),
        "replay": lambda client: client.replay("r"),
        "stop_replay": lambda client: client.stop_replay("r"),
        "events": lambda client: list(client.events("a", last_event_id="1", reconnect=False)),
    }


def operation(description: dict, request: httpx.Request) -> dict:
    """The operation of the description that a request is for."""
    for template, operations in description["paths"].items():
        pattern = re.sub(r"\\{\w+\\}", "[^/]+", re.escape(template))
        if re.fullmatch(pattern, request.url.path) and request.method.lower() in operations:
            return operations[request.method.lower()]
    raise AssertionError(f"{request.method} {request.url.path} is not in the description")


def test_each_request_is_in_the_description_of_the_service(service, tmp_path):
    description = httpx.get(f"{service[0]}/openapi.json").json()
    requests: list[httpx.Request] = []

    def answer(request: httpx.Request) -> httpx.Response:
        requests.append(request)
        return httpx.Response(200, json={"items": [], "next_cursor": None})

    client = flankwatch.Client("http://service")
    client._http = httpx.Client(base_url="http://service", transport=httpx.MockTransport(answer))
    all_calls = calls(tmp_path)
    assert set(all_calls) == set(methods(flankwatch.Client)) - {"request", "close"}
    for name, call in all_calls.items():
        before = len(requests)
        call(client)
        assert len(requests) > before, name
    for request in requests:
        found = operation(description, request)
        known = {parameter["name"].lower() for parameter in found.get("parameters", [])}
        assert set(request.url.params) <= known, request.url
        assert "idempotency-key" not in request.headers or "idempotency-key" in known
        if request.content:
            media_type = request.headers["content-type"]
            assert media_type in found["requestBody"]["content"], f"{request.url}: {media_type}"


def test_a_token_is_sent(program, tmp_path):
    def token(scope: str) -> str:
        command = [program, "token", "create", scope, "--scope", scope, "--data-dir", tmp_path]
        return subprocess.run(command, capture_output=True, text=True, check=True).stdout.split()[-1]

    tokens = {scope: token(scope) for scope in ("read", "admin")}
    with serve(program, tmp_path) as url:
        for wrong in (None, "wrong"):
            with flankwatch.Client(url, wrong) as client, pytest.raises(flankwatch.ServiceError) as refused:
                client.assets()
            assert refused.value.status == 401
        description = {"id": "rig", "gear": {"teeth": [24, 36], "shaft_speed_hz": 24.5}}
        with flankwatch.Client(url, tokens["admin"]) as client:
            client.create_asset(description)
        with flankwatch.Client(url, tokens["read"]) as client:
            assert [asset["id"] for asset in client.assets()] == ["rig"]
            with pytest.raises(flankwatch.ServiceError) as refused:
                client.delete_asset("rig")
            assert refused.value.status == 403
            with pytest.raises(flankwatch.ServiceError) as refused:
                next(client.events("no-such-asset"))
            assert refused.value.status == 404


class Proxy:
    """Forwards connections to a port, and cuts them on request."""

    def __init__(self, port: int) -> None:
        self._port = port
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.port = self._listener.getsockname()[1]
        self._open: list[socket.socket] = []
        threading.Thread(target=self._accept, daemon=True).start()

    def _accept(self) -> None:
        while True:
            try:
                client, _ = self._listener.accept()
            except OSError:
                return
            server = socket.create_connection(("127.0.0.1", self._port))
            self._open += [client, server]
            for source, sink in ((client, server), (server, client)):
                threading.Thread(target=self._forward, args=(source, sink), daemon=True).start()

    @staticmethod
    def _forward(source: socket.socket, sink: socket.socket) -> None:
        try:
            while data := source.recv(65536):
                sink.sendall(data)
        except OSError:
            return

    def cut(self) -> None:
        for each in self._open:
            # One that was closed from the other side is no longer connected.
            with contextlib.suppress(OSError):
                each.shutdown(socket.SHUT_RDWR)
        self._open.clear()

    def close(self) -> None:
        self._listener.close()
        self.cut()


@pytest.fixture
def proxy(service) -> Iterator[Proxy]:
    proxy = Proxy(int(service[0].rsplit(":", 1)[1]))
    yield proxy
    proxy.close()


def test_events_continue_after_a_lost_connection(client, asset, proxy):
    """An event that happens while the connection is lost is received after it."""
    received: list[flankwatch.Event] = []
    arrived = threading.Condition()

    def listen() -> None:
        with flankwatch.Client(f"http://127.0.0.1:{proxy.port}") as listener:
            for event in listener.events(asset):
                with arrived:
                    received.append(event)
                    arrived.notify()
                if event.kind == "indicators" and event.data["start_time"] == "2026-03-01T23:00:00Z":
                    return

    def upload(hour: int) -> None:
        client.upload(asset, gear_signal(hour)[:8000], RATE_HZ, start_time=f"2026-03-01T{hour:02}:00:00Z")

    thread = threading.Thread(target=listen, daemon=True)
    thread.start()
    hour = 0
    with arrived:
        # The stream begins when it is connected.
        while not received and hour < 20:
            upload(hour)
            hour += 1
            arrived.wait(0.3)
    assert received
    time.sleep(0.3)
    proxy.cut()
    upload(22)
    upload(23)
    thread.join(20)
    assert not thread.is_alive()
    times = [event.data["start_time"] for event in received if event.kind == "indicators"]
    assert times[-2:] == ["2026-03-01T22:00:00Z", "2026-03-01T23:00:00Z"]
    assert len(times) == len(set(times)) and len({event.id for event in received}) == len(received)
    assert "lost" not in {event.kind for event in received}


def test_without_reconnection_a_lost_connection_is_an_error(client, asset, proxy):
    with flankwatch.Client(f"http://127.0.0.1:{proxy.port}") as listener:
        threading.Timer(0.5, proxy.cut).start()
        with pytest.raises(httpx.TransportError):
            list(listener.events(asset, reconnect=False))


def test_a_replay_is_stopped(client, service, asset):
    recordings = service[1] / "recordings"
    recordings.mkdir(exist_ok=True)
    # Above 2 minutes it is cut into records of 10 s, which a replay in real time sends one after the other.
    x = np.tile(gear_signal(count=2000), 130)
    soundfile.write(recordings / "long.wav", x, 2000, subtype="FLOAT")
    replay = client.start_replay(asset, "long.wav", pace="realtime")
    assert client.replay(replay["id"])["state"] == "running"
    client.stop_replay(replay["id"])
    for _ in range(100):
        state = client.replay(replay["id"])
        if state["state"] != "running":
            break
        time.sleep(0.1)
    assert state["state"] == "stopped"
    assert len(list(client.segments(asset))) < 13
