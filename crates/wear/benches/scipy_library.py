"""Compares SciPy's solve_ivp on a short part of one wear state with the library's processor time.

    cargo build --release
    cargo bench --bench library            # prints the library's processor time
    python3 crates/wear/benches/scipy_library.py target/release/flankwatch <processor seconds of 50 states × 2 s>

The excitation is the mesh period that `flankwatch model` prints, so only the integration is compared; the library's time includes geometry, filter and
features. Masses, supports and errors are those of fixtures/pairs/shen2022.toml.
"""
import csv
import io
import math
import subprocess
import sys
import time

import numpy as np
from scipy.integrate import solve_ivp

SECONDS = 0.02
LIBRARY_SECONDS = 50 * 2.0
TEETH, MODULE_M, WIDTH_M, DENSITY = (24, 26), 6e-3, 50e-3, 7850.0
TORQUE, SHAFT_HZ, DAMPING_RATIO = 1300.0, 16.64, 0.5
SUPPORT_K, SUPPORT_C = 6.56e7, 1.8e5
LONG_M, SHORT_M = 30e-6, 15e-6


def mesh_period(program):
    """Stiffness in N/m and lag in m over a mesh period, base radii in m, masses and mesh mass in kg."""
    out = subprocess.run([program, "model", "--wear-mm", "0.1", "--points", "1000"], check=True, capture_output=True, text=True).stdout
    rows = list(csv.DictReader(io.StringIO(out)))
    k = np.array([float(row["stiffness_n_per_m"]) for row in rows])
    pitch = [z * MODULE_M / 2 for z in TEETH]
    base = [r * math.cos(math.radians(20)) for r in pitch]
    lag = base[1] * np.array([float(row["uste_rad"]) for row in rows])
    mass = [math.pi * r * r * WIDTH_M * DENSITY for r in pitch]
    mesh_mass = 1 / sum(b * b / (0.5 * m * r * r) for b, m, r in zip(base, mass, pitch))
    return k, lag, base, mass, mesh_mass


def main():
    program, library_processor_s = sys.argv[1], float(sys.argv[2])
    k, lag, base, mass, mesh_mass = mesh_period(program)
    mesh_c = 2 * DAMPING_RATIO * math.sqrt(k.mean() * mesh_mass)
    mesh_hz = SHAFT_HZ * TEETH[0]
    places = np.linspace(0, 1, len(k) + 1)
    k, lag = np.append(k, k[0]), np.append(lag, lag[0])
    lag_rate = np.gradient(lag, places) * mesh_hz
    force = TORQUE / base[0]

    def derivative(t, s):
        phase = (t * mesh_hz) % 1.0
        wl, ws = 2 * math.pi * SHAFT_HZ, 2 * math.pi * mesh_hz
        error = np.interp(phase, places, lag) + LONG_M * math.sin(wl * t) + SHORT_M * math.sin(ws * t)
        rate = np.interp(phase, places, lag_rate) + LONG_M * wl * math.cos(wl * t) + SHORT_M * ws * math.cos(ws * t)
        push = np.interp(phase, places, k) * (s[0] - s[1] + s[2] - error) + mesh_c * (s[3] - s[4] + s[5] - rate)
        return [s[3], s[4], s[5], (force - push) / mesh_mass,
                (push - SUPPORT_K * s[1] - SUPPORT_C * s[4]) / mass[0],
                (-push - SUPPORT_K * s[2] - SUPPORT_C * s[5]) / mass[1]]

    start = time.process_time()
    times = np.arange(int(SECONDS * 20_000)) / 20_000
    solved = solve_ivp(derivative, (0, SECONDS), np.zeros(6), method="RK45", t_eval=times, rtol=1e-8, atol=1e-14, max_step=1 / 20_000)
    spent = time.process_time() - start
    assert solved.success, solved.message
    per_second = spent / SECONDS
    print(f"solve_ivp: {per_second:.1f} s of processor time for a second of one state ({solved.nfev} evaluations in {SECONDS} s)")
    print(f"ratio to the library: {per_second * LIBRARY_SECONDS / library_processor_s:.0f}")


if __name__ == "__main__":
    main()
