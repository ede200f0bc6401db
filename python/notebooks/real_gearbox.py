# %% [markdown]
# # Indicators of a real gearbox compared with SciPy
# Uses a recording from the folder in `FLANKWATCH_DATA`, or else a simulated one.

# %%
import os
from pathlib import Path

import flankwatch
import numpy as np
from scipy import fft, signal, stats

path = Path(os.environ.get("FLANKWATCH_DATA", "")) / "gearbox-spectraquest" / "h30hz0.csv.gz"
if path.is_file():
    recording = flankwatch.read(path, rate_hz=12_800.0)
    x, rate_hz, teeth, nominal_hz, unit = recording["a1"].samples, 12_800.0, 32, 29.7, "1"
    print("recording:", path)
else:
    pair = flankwatch.Pair.shen2022()
    run = pair.simulate(20_000.0, 5.0, wear_um=60.0)
    x = run.samples.astype(np.float32)
    rate_hz, teeth, nominal_hz, unit = run.rate_hz, pair.teeth[0], run.shaft_speed_hz, run.unit
    print(f"there is no recording {path}, so a simulation is analysed; FLANKWATCH_DATA names the folder")

# %%
indicators = flankwatch.indicators(x, rate_hz, teeth=teeth, nominal_shaft_speed_hz=nominal_hz, unit=unit)
exact = x.astype(float)
by_scipy = {
    "rms": np.sqrt(np.mean(exact**2)),
    "kurtosis": stats.kurtosis(exact, fisher=False),
    "crest_factor": np.max(np.abs(exact)) / np.sqrt(np.mean(exact**2)),
}
for name, value in by_scipy.items():
    print(f"{name:14} {indicators[name]:12.6f} {value:12.6f}")
    assert np.isclose(indicators[name], value, rtol=1e-10)

# %% [markdown]
# The envelope spectrum of a band has the same lines as the modulus of SciPy's analytic signal: of the band's
# bins, and after a Butterworth filter, which is not as steep.

# %%
band_hz = [1000.0, 2000.0]
envelope = flankwatch.envelope_spectrum(x, rate_hz, band_hz=band_hz, unit=unit)
bins = envelope.amplitude.size
# The transform may omit a few samples at the end.
exact = exact[: round(rate_hz / envelope.resolution_hz)]


def hann_spectrum(modulus: np.ndarray) -> np.ndarray:
    """The amplitude spectrum of a modulus without its mean, at the bins of the envelope spectrum."""
    window = signal.get_window("hann", modulus.size)
    return 2 * np.abs(np.fft.rfft((modulus - modulus.mean()) * window))[:bins] / window.sum()


frequency_hz = fft.fftfreq(exact.size, 1 / rate_hz)
is_outside = (frequency_hz < band_hz[0]) | (frequency_hz > band_hz[1])
transform = fft.fft(exact - exact.mean())
transform[is_outside] = 0
by_scipy_envelope = hann_spectrum(np.abs(2 * fft.ifft(transform)))
sections = signal.butter(6, band_hz, btype="bandpass", fs=rate_hz, output="sos")
by_filter = hann_spectrum(np.abs(signal.hilbert(signal.sosfiltfilt(sections, exact))))

highest = np.max(by_scipy_envelope)
difference = np.max(np.abs(envelope.amplitude - by_scipy_envelope)) / highest
strongest = [1 + int(np.argmax(each[1:])) for each in (envelope.amplitude, by_scipy_envelope, by_filter)]
print("strongest line:", envelope.frequency_hz[strongest[0]], "Hz; greatest difference:", f"{difference:.2%}")
# The package computes the modulus with 4 samples per bin of the band, so its kinks near zero alias a little.
assert difference < 0.02
assert len(set(strongest)) == 1
