"""The gear model, libraries, runs and trackers."""

from __future__ import annotations

import datetime
import os
import signal
import threading

import flankwatch
import numpy as np
import pytest


@pytest.fixture(scope="module")
def pair() -> flankwatch.Pair:
    return flankwatch.Pair.shen2022()


@pytest.fixture(scope="module")
def library(pair) -> flankwatch.Library:
    return flankwatch.Library.build(pair, states=5, seconds=0.5)


def test_wear_softens_the_mesh(pair):
    new, worn = pair.mesh(), pair.mesh(100.0)
    assert worn.mean_stiffness_n_per_m < new.mean_stiffness_n_per_m
    assert new.phi1_rad.shape == worn.uste_rad.shape == (1000,)
    assert new.pairs_in_contact.dtype == np.uint32
    assert pair.teeth == (24, 26) and pair.contact_ratio > 1
    assert np.ptp(pair.tooth_contact(100.0).phi1_rad) > 0
    flank = pair.flank(1, 100.0)
    assert flank.depth_um.max() == pytest.approx(100.0, rel=1e-3) and flank.radius_mm.shape == (201,)


def test_a_simulation_contains_its_wear(pair):
    run = pair.simulate(20_000.0, 0.5, wear_um=80.0, torque_nm=900.0)
    assert run.samples.shape == (10_000,) and run.samples.dtype == np.float64
    assert (run.wear_um, run.torque_nm, run.shaft_speed_hz, run.unit) == (80.0, 900.0, 16.64, "m/s2")
    again = pair.simulate(20_000.0, 0.5, wear_um=80.0, torque_nm=900.0)
    assert np.array_equal(run.samples, again.samples)
    assert not np.array_equal(
        run.samples, pair.simulate(20_000.0, 0.5, wear_um=80.0, torque_nm=900.0, seed=9).samples
    )


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda pair: pair.mesh(torque_nm=0.0), "operation.torque_nm is 0"),
        (lambda pair: pair.mesh(np.nan), "NaN"),
        (lambda pair: pair.mesh(10.0, turns=5.0), "wear is given more than once"),
        (lambda pair: pair.mesh(contact="soft"), 'contact is "soft"'),
        (lambda pair: pair.mesh(points=1), "points is 1"),
        (lambda pair: pair.mesh(profile=np.zeros((2, 2))), "profile is 2 columns"),
        (lambda pair: pair.flank(3), "gear is 3"),
        (lambda pair: pair.simulate(20_000.0, -1.0), "seconds is -1"),
        (lambda pair: flankwatch.Pair.from_toml("a = 1"), "not a pair file"),
        (lambda pair: flankwatch.Library.build(pair, states=1), "states is 1"),
        (lambda pair: flankwatch.Run(pair, records=0), "records is 0"),
        (lambda pair: flankwatch.Tracker(), "library is None"),
        (lambda pair: flankwatch.Tracker(5), "library is int"),
        (
            lambda pair: flankwatch.Tracker(teeth=24, nominal_shaft_speed_hz=25, baseline_records=2),
            "baseline_records is 2",
        ),
    ],
)
def test_errors_name_the_argument_its_value_and_the_expectation(pair, call, message):
    with pytest.raises(ValueError, match=message):
        call(pair)


def test_errors_name_unreadable_files(tmp_path, pair, library):
    for call in (
        lambda path: flankwatch.Pair.from_file(path),
        lambda path: flankwatch.Library.load(path),
        lambda path: flankwatch.Tracker(library).load(path),
    ):
        with pytest.raises(OSError, match="no-such-file"):
            call(tmp_path / "no-such-file")
    damaged = tmp_path / "damaged"
    damaged.write_bytes(b"flankwatch-library 2 0\n{}")
    with pytest.raises(ValueError, match="damaged library file"):
        flankwatch.Library.load(damaged)
    with pytest.raises(ValueError, match="not a tracker state"):
        flankwatch.Tracker(library).restore("{}")


def test_a_library_build_reports_progress(library, pair):
    told = []
    again = flankwatch.Library.build(
        pair, states=5, seconds=0.5, progress=lambda done, total: told.append((done, total))
    )
    assert told[-1] == (5, 5) and told == sorted(told)
    assert again.id == library.id and len(library) == 5
    assert np.array_equal(again.indicator("rms"), library.indicator("rms"))
    assert library.mesh(0)["phi1_rad"][0] == pair.mesh().phi1_rad[0]
    with pytest.raises(ValueError, match="name is"):
        library.indicator("rmss")


def test_an_exception_in_the_callback_stops_the_build(pair):
    class Enough(Exception):
        pass

    def progress(done, total):
        raise Enough

    with pytest.raises(Enough):
        flankwatch.Library.build(pair, states=200, progress=progress)


def test_ctrl_c_stops_the_build(pair):
    # Python inherits an ignored SIGINT, as in background jobs of a shell.
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        threading.Timer(0.3, os.kill, (os.getpid(), signal.SIGINT)).start()
        with pytest.raises(KeyboardInterrupt):
            flankwatch.Library.build(pair, states=500, seconds=10.0)
    finally:
        signal.signal(signal.SIGINT, before)


def test_a_tracker_continues_from_its_saved_state(pair, library, tmp_path):
    run = flankwatch.Run(pair, records=10, seconds=1.0, interval_s=3600.0, snr_db=30.0)
    assert len(run) == 10 and run[-1].wear_um > run[0].wear_um == 0.0
    assert np.array_equal(run[3].samples, run[3].samples)
    with pytest.raises(IndexError):
        run[10]
    tracker = flankwatch.Tracker(library, baseline_records=8)
    times = [datetime.datetime(2026, 1, 1, n) for n in range(8)] + [
        np.datetime64("2026-01-01T08:00"),
        "2026-01-01T09:00:00Z",
    ]
    for record, time in zip(run, times):
        said = tracker.update(record.samples, record.rate_hz, time, torque_nm=record.torque_nm)
    assert said["time"] == "2026-01-01T09:00:00Z"
    assert said["wear"]["baseline"]["have"] == 8 and said["wear"]["status"] != "collecting_baseline"
    assert "na4" in said["indicators"]
    other = flankwatch.Tracker(flankwatch.Ensemble.build(library, members=4))
    with pytest.raises(ValueError, match="another number of members"):
        other.restore(tracker.state)
    flankwatch.Tracker(library).restore(tracker.state)
    with pytest.raises(ValueError, match="time is 'noon'"):
        tracker.update(run[0].samples, 20_000.0, "noon")
    tracker.maintenance("gear_replaced", "2026-01-02T00:00:00Z")
    with pytest.raises(ValueError, match="maintenance: "):
        tracker.maintenance("painted", 0)
    with pytest.raises(ValueError, match="depth_um is -1"):
        tracker.maintenance("inspected", 0, inspection={"depth_um": -1})
    after = tracker.update(run[0].samples, 20_000.0, "2026-01-02T00:00:01Z")
    assert after["wear"]["status"] == "collecting_baseline"


def test_an_ensemble_is_saved_and_loaded(library, tmp_path):
    told = []
    ensemble = flankwatch.Ensemble.build(library, members=4, progress=lambda *now: told.append(now))
    ensemble.save(tmp_path / "ensemble")
    again = flankwatch.Ensemble.load(tmp_path / "ensemble", library)
    assert (again.id, len(again)) == (ensemble.id, 4) and told
    assert flankwatch.Tracker(again).state == flankwatch.Tracker(ensemble).state
