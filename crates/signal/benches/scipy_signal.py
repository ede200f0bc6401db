"""What NumPy and SciPy take for what the service keeps of a record of 200 000 samples, beside the program's own numbers.

    pip install numpy scipy
    cargo build --release
    python3 crates/signal/benches/scipy_signal.py target/release/flankwatch

Without the program the numbers are not compared. The shaft's angle comes from the phase of a mesh harmonic, and
samples over the angle from a cubic spline, which is what SciPy offers; the program interpolates better and so
differs in what rests on the difference signal.
"""

import json
import pathlib
import subprocess
import sys
import tempfile
import time

import numpy as np
from scipy import fft, interpolate, signal, stats
from scipy.io import wavfile

RATE, SAMPLES, SHAFT_HZ, TEETH = 20000.0, 200000, 16.64, 24
HARMONIC = 4  # whose phase gives the angle
ENDS = 2  # turns at either end, where the phase of a band is not to be trusted
ROUNDS = 30

turn = 2 * np.pi * SHAFT_HZ * np.arange(SAMPLES) / RATE
x = 0.1 * np.random.default_rng(1).standard_normal(SAMPLES)
for h in range(1, 11):
    x += (1 + 0.2 * np.cos(turn)) / h * np.sin(TEETH * h * turn)
x = x.astype(np.float32)
band = signal.butter(4, [0.5 * TEETH * SHAFT_HZ, 2.5 * TEETH * SHAFT_HZ], "bandpass", fs=RATE, output="sos")


def amplitudes(y):
    window = signal.windows.hann(len(y), sym=False)
    return 4 / len(y) * np.abs(fft.rfft((y - y.mean()) * window))


def line(amplitude, position):
    low = int(np.ceil(position - 1.5))
    k = low + int(np.argmax(amplitude[low : int(np.floor(position + 1.5)) + 1]))
    ratio = max(amplitude[k - 1], amplitude[k + 1]) / amplitude[k]
    distance = min(max((2 * ratio - 1) / (ratio + 1), 0), 0.5)
    return amplitude[k] / (np.sinc(distance) / (1 - distance**2))


def basic():
    """RMS, kurtosis, amplitude spectrum with mesh lines, envelope spectrum."""
    y = x.astype(float)
    amplitude = amplitudes(y)
    lines = [amplitude[round(h * TEETH * SHAFT_HZ * SAMPLES / RATE)] for h in range(1, 11)]
    envelope = amplitudes(np.abs(signal.hilbert(signal.sosfilt(band, y))))
    return np.sqrt(np.mean(y**2)), stats.kurtosis(y, fisher=False), lines, envelope


def shaft_speed(amplitude):
    """The comb of ten mesh harmonics that stands highest within 5 %."""
    candidates = SHAFT_HZ * np.linspace(0.95, 1.05, 2001)
    places = np.rint(np.outer(candidates, TEETH * np.arange(1, 11)) * SAMPLES / RATE).astype(int)
    return candidates[np.argmax(np.log(amplitude[places]).sum(axis=1))]


def between_lines(amplitude, shaft):
    """Noise and energy of octaves, noise beside lines, sidebands, lines of the shaft."""
    step = RATE / SAMPLES
    frequency = np.arange(len(amplitude)) * step
    power = amplitude**2
    octaves = []
    for centre in 31.25 * 2.0 ** np.arange(9):
        inside = power[int(centre / 2**0.5 / step) : int(centre * 2**0.5 / step)]
        octaves += [np.median(inside), inside.sum()]
    near = []
    for h in range(1, 17):
        place = h * TEETH * shaft / step
        near.append(line(amplitude, place))
        near.append(np.median(amplitude[int(place - 80) : int(place + 80)]))
        near += [line(amplitude, place + side * k * shaft / step) for side in (-1, 1) for k in (1, 2, 3)]
    shafts = [line(amplitude, order * shaft / step) for order in range(1, 5)]
    velocity = slice(int(np.ceil(10 / step)), int(1000 / step) + 1)
    speed = np.sqrt(np.sum(power[velocity] / (2 * np.pi * frequency[velocity]) ** 2) / 3)
    return octaves, near, shafts, 1e3 * speed


def over_the_angle(y, shaft):
    """The record over whole turns of the shaft."""
    bins = fft.fft(y)
    middle, half = HARMONIC * TEETH * shaft * SAMPLES / RATE, 0.5 * shaft * SAMPLES / RATE
    keep = np.zeros(SAMPLES)
    keep[int(middle - half) : int(middle + half)] = 2
    revolutions = np.unwrap(np.angle(fft.ifft(bins * keep))) / (2 * np.pi * HARMONIC * TEETH)
    revolutions -= revolutions[0]
    turns = int(revolutions[-1]) - 2 * ENDS
    per_turn = 1250
    at = np.interp(ENDS + np.arange(turns * per_turn) / per_turn, revolutions, np.arange(SAMPLES))
    return turns, per_turn, interpolate.CubicSpline(np.arange(SAMPLES), y)(at)


def over_turns(turns, per_turn, turned):
    """Indicators of the synchronous average, and averages of fewer turns for the teeth."""
    average = turned.reshape(turns, per_turn).mean(axis=0)
    average = average - average.mean()
    bins = fft.rfft(average)
    k = np.arange(len(bins))
    a = 2 * np.abs(bins) / per_turn
    regular = (k > 0) & ((k <= 2) | (k % TEETH == 0))
    sideband = (k > TEETH // 2) & ((k % TEETH == 1) | (k % TEETH == TEETH - 1))

    def part(keep):
        return fft.irfft(np.where(keep, bins, 0), per_turn)

    g, r, d = part(regular), part(~regular), part(~regular & ~sideband)
    envelope = np.abs(signal.hilbert(part((k >= TEETH - 6) & (k <= TEETH + 6))))
    envelope = envelope - envelope.mean()
    orders = np.arange(1, 7)
    teeth = []
    for count in (2, 8, 32, 128):
        parts = turned[: turns // count * count * per_turn].reshape(-1, count, per_turn).mean(axis=1)
        spectra = fft.rfft(parts, axis=1)
        spectra[:, ::TEETH] = 0
        teeth.append(np.abs(fft.irfft(spectra, axis=1)).max(axis=1))
    return teeth, {
        "omx_tracked": line(amplitudes(turned), TEETH * turns),
        "sideband_energy_ratio": (a[TEETH - orders].sum() + a[TEETH + orders].sum()) / a[TEETH],
        "sideband_level_factor": (a[TEETH - 1] + a[TEETH + 1]) / average.std(),
        "fm0": np.ptp(average) / sum(a[h * TEETH] for h in range(1, 11)),
        "fm4": stats.kurtosis(d, fisher=False),
        "m6a": np.mean(d**6) / np.mean(d**2) ** 3,
        "m8a": np.mean(d**8) / np.mean(d**2) ** 4,
        "energy_ratio": d.std() / g.std(),
        "residual_variance": r.var(),
        "residual_fourth_moment": np.mean(r**4),
        "mesh_envelope_variance": envelope.var(),
        "mesh_envelope_fourth_moment": np.mean(envelope**4),
    }


def whole():
    """All that the service keeps of a record."""
    y = x.astype(float)
    peak, rms = np.abs(y).max(), np.sqrt(np.mean(y**2))
    amplitude = amplitudes(y)
    shaft = shaft_speed(amplitude)
    velocity = between_lines(amplitude, shaft)[-1]
    amplitudes(np.abs(signal.hilbert(signal.sosfilt(band, y))))
    values = over_turns(*over_the_angle(y - y.mean(), shaft))[1]
    step = TEETH * shaft * SAMPLES / RATE
    values |= {f"mesh_{h}": line(amplitude, h * step) for h in range(1, 11)}
    values |= {"rms": rms, "peak": peak, "crest_factor": peak / rms, "velocity_rms": velocity}
    return values | {"kurtosis": stats.kurtosis(y, fisher=False)}


def of_program(program):
    with tempfile.TemporaryDirectory() as folder:
        record, asset = pathlib.Path(folder, "record.wav"), pathlib.Path(folder, "asset.toml")
        wavfile.write(record, int(RATE), x)
        asset.write_text(
            f'id = "bench"\n[gear]\nteeth = [{TEETH}, 26]\nshaft_speed_hz = {SHAFT_HZ}\n[sensor]\nunit = "m/s2"\n'
        )
        words = [program, "analyze", record, "--asset", asset, "--format", "json"]
        return json.loads(subprocess.run(words, check=True, capture_output=True).stdout)[0]["indicators"]


def timed(name, work):
    times, before = [], time.process_time()
    for _ in range(ROUNDS):
        start = time.perf_counter()
        work()
        times.append(time.perf_counter() - start)
    processor = (time.process_time() - before) / ROUNDS
    print(f"{name}: {1e3 * min(times):.1f} ms; on the processor {1e3 * processor:.1f} ms")


if __name__ == "__main__":
    if len(sys.argv) > 1:
        own, theirs = of_program(sys.argv[1]), whole()
        for name in sorted(theirs):
            print(f"{name:32} {theirs[name]:12.6g} {own[name]:12.6g} {theirs[name] / own[name] - 1:+.1e}")
    timed("RMS, kurtosis, spectrum, mesh lines, envelope", basic)
    timed("all that the service keeps", whole)
