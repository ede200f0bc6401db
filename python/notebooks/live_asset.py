# %% [markdown]
# # Watch a live asset
# `FLANKWATCH_URL` is the address of a running service. A thread simulates the machine; this notebook prints the events.

# %%
import os
import threading

import flankwatch

url = os.environ.get("FLANKWATCH_URL", "http://127.0.0.1:8600")
token = os.environ.get("FLANKWATCH_TOKEN")
pair = flankwatch.Pair.shen2022()
name = "notebook-rig"

with flankwatch.Client(url, token) as client:
    if name not in [asset["id"] for asset in client.assets()]:
        client.create_asset(
            {
                "id": name,
                "gear": {"teeth": list(pair.teeth), "shaft_speed_hz": pair.shaft_speed_hz},
                "sensor": {"unit": "m/s2"},
            }
        )


# %%
def simulate_machine() -> None:
    """Uploads five records, one after the other, in place of a machine."""
    run = flankwatch.Run(pair, records=5, seconds=1.0)
    with flankwatch.Client(url, token) as machine:
        for record in run:
            machine.upload(
                name, record.samples, record.rate_hz, start_time=record.time, torque_nm=record.torque_nm
            )


# %%
with flankwatch.Client(url, token) as client:
    events = client.events(name)
    threading.Timer(0.5, simulate_machine).start()
    seen = 0
    for event in events:
        print(event.kind, event.data.get("start_time", ""))
        seen += event.kind == "wear"
        if seen == 3:
            break
    print(client.trend(name, ["rms", "omx"], frame="pandas"))
