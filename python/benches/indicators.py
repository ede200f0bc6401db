"""Times the package's indicators of a record of 200 000 samples, and SciPy on the same quantities.

    pip install ./python pyperf scipy
    python3 python/benches/indicators.py
"""

import pathlib
import sys

import flankwatch
import pyperf

sys.path.insert(0, str(pathlib.Path(__file__).parents[2] / "crates/signal/benches"))
import scipy_signal as scipy_set  # noqa: E402


def indicators():
    return flankwatch.indicators(
        scipy_set.x,
        scipy_set.RATE,
        teeth=scipy_set.TEETH,
        nominal_shaft_speed_hz=scipy_set.SHAFT_HZ,
        unit="m/s2",
    )


runner = pyperf.Runner()
runner.bench_func("SciPy, same quantities", scipy_set.whole)
runner.bench_func("flankwatch.indicators", indicators)
