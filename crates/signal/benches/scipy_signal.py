"""What NumPy and SciPy take for the same record: RMS, kurtosis, amplitude spectrum with mesh lines, envelope spectrum.

    python3 crates/signal/benches/scipy_signal.py
"""

import time

import numpy as np
from scipy import fft, signal, stats

rate, n, shaft = 20000.0, 200000, 16.64
turn = 2 * np.pi * shaft * np.arange(n) / rate
x = 0.1 * np.random.default_rng(1).standard_normal(n)
for h in range(1, 11):
    x += (1 + 0.2 * np.cos(turn)) / h * np.sin(24 * h * turn)
x = x.astype(np.float32)
band = signal.butter(4, [0.5 * 24 * shaft, 2.5 * 24 * shaft], "bandpass", fs=rate, output="sos")


def pipeline():
    y = x.astype(float)
    rms, kurtosis = np.sqrt(np.mean(y**2)), stats.kurtosis(y, fisher=False)
    window = signal.windows.hann(n, sym=False)
    amplitude = 4 / n * np.abs(fft.rfft((y - y.mean()) * window))
    lines = [amplitude[round(h * 24 * shaft * n / rate)] for h in range(1, 11)]
    envelope = np.abs(signal.hilbert(signal.sosfilt(band, y)))
    return rms, kurtosis, lines, 4 / n * np.abs(fft.rfft((envelope - envelope.mean()) * window))


times, processor_before = [], time.process_time()
for _ in range(30):
    start = time.perf_counter()
    pipeline()
    times.append(time.perf_counter() - start)
processor = (time.process_time() - processor_before) / len(times)
print(f"SciPy pipeline: {1e3 * min(times):.2f} ms; on the processor {1e3 * processor:.2f} ms")
