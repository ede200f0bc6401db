# %% [markdown]
# # Indicators of a real gearbox compared with SciPy
# Uses a recording from the folder in `FLANKWATCH_DATA`, or else a simulated one.

# %%
import gzip
import os
from pathlib import Path

import flankwatch
import numpy as np
from scipy import signal, stats

path = Path(os.environ.get("FLANKWATCH_DATA", "")) / "gearbox-spectraquest" / "h30hz0.csv.gz"
if path.is_file():
    with gzip.open(path, "rt") as file:
        x = np.loadtxt(file, delimiter=",", skiprows=1, usecols=0, dtype=np.float32)
    rate_hz, teeth, nominal_hz, unit = 12_800.0, 32, 29.7, "1"
else:
    pair = flankwatch.Pair.shen2022()
    run = pair.simulate(20_000.0, 5.0, wear_um=60.0)
    x = run.samples.astype(np.float32)
    rate_hz, teeth, nominal_hz, unit = run.rate_hz, pair.teeth[0], run.shaft_speed_hz, run.unit

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
# The envelope spectrum of a band has the same lines as the analytic signal after a Butterworth filter.

# %%
band_hz = [1000.0, 2000.0]
envelope = flankwatch.envelope_spectrum(x, rate_hz, band_hz=band_hz, unit=unit)
sections = signal.butter(6, band_hz, btype="bandpass", fs=rate_hz, output="sos")
analytic = np.abs(signal.hilbert(signal.sosfiltfilt(sections, exact)))
spectrum = (
    2 * np.abs(np.fft.rfft((analytic - analytic.mean()) * signal.get_window("hann", x.size))) / (x.size / 2)
)
print(
    "strongest line:",
    envelope.frequency_hz[1 + np.argmax(envelope.amplitude[1:])],
    "Hz;",
    np.argmax(spectrum) * rate_hz / x.size,
    "Hz by SciPy",
)
