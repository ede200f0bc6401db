"""The client and the import of folders against a running service."""

from __future__ import annotations

import threading
import time

import flankwatch
import httpx
import numpy as np
import pyarrow.parquet
import pytest
import soundfile
from flankwatch.events import Event, parse_events

from conftest import gear_signal

RATE_HZ = 20_000.0


def test_assets_are_created_changed_and_deleted(client, asset):
    assert asset in [each["id"] for each in client.assets()]
    description = {"id": asset, "name": "Bench", "gear": {"teeth": [24, 36], "shaft_speed_hz": 25.0}}
    client.replace_asset(asset, description)
    assert client.asset(asset)["name"] == "Bench"
    client.delete_asset(asset)
    with pytest.raises(flankwatch.ServiceError, match="404"):
        client.asset(asset)


def test_the_service_computes_the_same_indicators_for_an_upload(client, asset):
    x = gear_signal(1).astype(np.float32)
    segment = client.upload(asset, x, RATE_HZ, start_time="2026-03-01T08:00:00Z", shaft_speed_hz=25.0)
    here = flankwatch.indicators(
        x, RATE_HZ, teeth=24, nominal_shaft_speed_hz=24.5, shaft_speed_hz=25.0, unit="m/s2"
    )
    stored = client.segment(segment["id"])["indicators"]
    assert {name: value for name, value in stored.items() if name in here} == dict(here)
    waveform = client.waveform(segment["id"], max_points=200_000)
    assert np.array_equal(np.asarray(waveform["value"], dtype=np.float32), x) and not waveform["reduced"]
    repeat = client.upload(asset, x, RATE_HZ, start_time="2026-03-01T08:00:00Z", shaft_speed_hz=25.0)
    assert repeat["replayed"] and repeat["id"] == segment["id"]


def test_a_csv_file_is_sent_unchanged(client, asset, tmp_path):
    path = tmp_path / "recording.csv"
    x = np.round(gear_signal(5)[:8000], 6).astype(np.float32)
    lines = [f"{n / RATE_HZ:.6f};{value!s}".replace(".", ",") for n, value in enumerate(x)]
    path.write_text("Messung;7\nZeit [s];Eingang [m/s²]\n" + "\n".join(lines), encoding="latin-1")
    segment = client.upload_file(asset, path, start_time="2026-03-01T08:00:00Z")
    assert (segment["channel"], segment["sample_rate_hz"], segment["unit"]) == ("Eingang", RATE_HZ, "m/s2")
    waveform = client.waveform(segment["id"], max_points=200_000)
    assert np.array_equal(np.asarray(waveform["value"], dtype=np.float32), x)
    with pytest.raises(flankwatch.ServiceError, match="the sampling rate is 21000 Hz, expected 20000 Hz"):
        client.upload_file(asset, path, rate_hz=21_000.0)


def test_several_channels_are_sent_together(client, asset):
    x = np.stack([gear_signal(1), gear_signal(2)])
    answer = client.upload(asset, x, RATE_HZ, start_time=0, channel_names=["in", "out"], unit="g")
    assert [segment["channel"] for segment in answer["segments"]] == ["in", "out"]
    assert len(list(client.segments(asset, channel="out"))) == 1


def test_trends_are_rows_or_frames(client, asset):
    for hour in range(3):
        client.upload(asset, gear_signal(hour), RATE_HZ, start_time=f"2026-03-01T0{hour}:00:00Z")
    rows = client.trend(asset, ["rms", "omx"])
    assert len(rows) == 3 and rows[0]["rms"] > 0
    pandas = client.trend(asset, ["rms", "omx"], frame="pandas")
    assert pandas["rms"].tolist() == [row["rms"] for row in rows]
    assert str(pandas["start_time"].dtype).endswith("UTC]")
    polars = client.wear_history(asset, frame="polars")
    assert polars.height == 3 and str(polars["start_time"].dtype.time_zone) == "UTC"
    assert client.wear(asset)["status"] == "collecting_baseline"
    with pytest.raises(ValueError, match="frame is 'arrow'"):
        client.trend(asset, ["rms"], frame="arrow")
    with pytest.raises(flankwatch.ServiceError, match="rms") as refused:
        client.trend(asset, ["rmss"])
    assert refused.value.status == 400


@pytest.mark.parametrize("path", ["indicators?names=rms,omx,kurtosis", "wear/history"])
def test_other_clients_get_trends_as_parquet(client, service, asset, path):
    for hour in range(3):
        client.upload(asset, gear_signal(hour), RATE_HZ, start_time=f"2026-03-01T0{hour}:00:00Z")
    url = f"{service[0]}/v1/assets/{asset}/{path}"
    rows = httpx.get(url).json()["items"]
    file = pyarrow.BufferReader(httpx.get(url, headers={"Accept": "application/vnd.apache.parquet"}).content)
    table = pyarrow.parquet.read_table(file)
    assert str(table.schema.field("start_time").type) == "timestamp[ns, tz=UTC]"
    for name in table.column_names:
        values = table[name].to_pylist()
        if name == "start_time":
            assert [value.isoformat().replace("+00:00", "Z") for value in values] == [
                row[name] for row in rows
            ]
        else:
            assert values == [row[name] for row in rows], name
    units = table.schema.metadata
    assert units[b"unit.rms" if "rms" in table.column_names else b"unit.median_um"].decode() in (
        "1",
        "m/s2",
        "µm",
    )


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda client, asset: client.upload(asset, [1.0, np.inf], 1.0), "1 samples that are not finite"),
        (lambda client, asset: client.upload(asset, ["a"], 1.0), "type <U1"),
        (lambda client, asset: client.upload(asset, [1.0], 1.0, start_time="noon"), "time is 'noon'"),
    ],
)
def test_invalid_samples_and_times_raise_before_sending(client, asset, call, message):
    with pytest.raises(ValueError, match=message):
        call(client, asset)


def test_a_service_error_names_the_field(client, asset):
    with pytest.raises(flankwatch.ServiceError) as refused:
        client.upload(asset, [1.0, 2.0], -1.0)
    assert refused.value.status in (400, 422) and "sample_rate_hz" in refused.value.detail


def test_events_are_received(client, service, asset):
    events, seen = [], threading.Event()

    def listen():
        with flankwatch.Client(service[0]) as listener:
            for event in listener.events(asset):
                events.append(event)
                if event.kind == "wear":
                    seen.set()
                    return

    thread = threading.Thread(target=listen, daemon=True)
    thread.start()
    for hour in range(20):
        client.upload(asset, gear_signal(hour)[:8000], RATE_HZ, start_time=f"2026-03-01T{hour:02}:00:00Z")
        if seen.wait(0.2):
            break
    assert seen.is_set()
    assert {event.kind for event in events} <= {"indicators", "wear", "asset", "history"}
    assert events[-1].id and events[-1].data["asset_id"] == asset


def test_events_are_parsed():
    lines = ["id: 7", "event: wear", 'data: {"a":', "data: 1}", "", ": comment", "data: words", ""]
    assert list(parse_events(iter(lines))) == [Event("wear", "7", {"a": 1}), Event("message", "7", "words")]


def test_a_request_to_a_busy_service_is_retried(monkeypatch):
    answers = [
        httpx.Response(503, headers={"retry-after": "0"}),
        httpx.Response(502, headers={"retry-after": "Sun, 01 Mar 2026 08:00:00 GMT"}),
        httpx.Response(200, json={"items": [], "next_cursor": None}),
    ]
    client = flankwatch.Client("http://service")
    client._http = httpx.Client(
        base_url="http://service", transport=httpx.MockTransport(lambda request: answers.pop(0))
    )
    waited: list[float] = []
    monkeypatch.setattr(time, "sleep", waited.append)
    assert client.assets() == [] and not answers and waited == [0.0, 1.0]


def test_replays_are_started_and_listed(client, service, asset):
    recordings = service[1] / "recordings"
    recordings.mkdir(exist_ok=True)
    soundfile.write(recordings / "run.wav", gear_signal(4).astype(np.float32), int(RATE_HZ), subtype="FLOAT")
    replay = client.start_replay(asset, "run.wav")
    for _ in range(100):
        state = client.replay(replay["id"])
        if state["state"] not in ("running", "waiting", "starting"):
            break
        time.sleep(0.1)
    assert len(list(client.segments(asset))) == 1
    assert replay["id"] in [each["id"] for each in client.replays()]
