"""Compares the ensemble's processor time with Runge-Kutta steps in Numba.

    cargo build --release
    python3 crates/wear/benches/numba_ensemble.py target/release/flankwatch [runs]

Needs NumPy, SciPy and Numba. The script times the classical Runge-Kutta method of order 4 on the model with four
degrees of freedom, scalar, compiled by Numba. The excitation is the mesh period that `flankwatch model`
prints; masses, supports and errors are those of fixtures/pairs/shen2022.toml. It then lets the program
simulate an ensemble from nothing. For each member and depth, Numba would have to take the steps of the
start-up transient and two mesh periods, at the step that the ensemble uses. The program's time also includes
the worn flanks, the compliance of the gears, the mesh cycles and the lines.
"""
import math
import resource
import subprocess
import sys
import tempfile
import time

import numba
import numpy as np

from scipy_library import SHAFT_HZ, SHORT_M, SUPPORT_C, SUPPORT_K, TEETH, TORQUE, mesh_period

MEMBERS, DEPTHS = 1280, 54
DAMPING_RATIO = 0.15
SAMPLES_A_PERIOD, STEPS_A_SAMPLE, PERIODS = 40, 8, 2
SETTLING_NEPERS = 16
STEPS = 400_000


@numba.njit
def derivative(t, s, out, k, lag, lag_rate, par):
    mesh_hz, mesh_mass, mesh_c, force, m1, m2 = par
    place = ((t * mesh_hz) % 1.0) * (len(k) - 1)
    cell = int(place)
    part = place - cell
    stiffness = k[cell] + part * (k[cell + 1] - k[cell])
    error = lag[cell] + part * (lag[cell + 1] - lag[cell])
    rate = lag_rate[cell] + part * (lag_rate[cell + 1] - lag_rate[cell])
    w = 2 * math.pi * mesh_hz
    error += SHORT_M * math.sin(w * t)
    rate += SHORT_M * w * math.cos(w * t)
    push = stiffness * (s[0] - s[1] + s[2] - error) + mesh_c * (s[3] - s[4] + s[5] - rate)
    out[0], out[1], out[2] = s[3], s[4], s[5]
    out[3] = (force - push) / mesh_mass
    out[4] = (push - SUPPORT_K * s[1] - SUPPORT_C * s[4]) / m1
    out[5] = (-push - SUPPORT_K * s[2] - SUPPORT_C * s[5]) / m2


@numba.njit
def integrate(steps, h, k, lag, lag_rate, par):
    s, a, b, c, d = np.zeros(6), np.zeros(6), np.zeros(6), np.zeros(6), np.zeros(6)
    for n in range(steps):
        t = n * h
        derivative(t, s, a, k, lag, lag_rate, par)
        derivative(t + h / 2, s + h / 2 * a, b, k, lag, lag_rate, par)
        derivative(t + h / 2, s + h / 2 * b, c, k, lag, lag_rate, par)
        derivative(t + h, s + h * c, d, k, lag, lag_rate, par)
        for i in range(6):
            s[i] += h / 6 * (a[i] + 2 * b[i] + 2 * c[i] + d[i])
    return s


def main():
    program, runs = sys.argv[1], int(sys.argv[2]) if len(sys.argv) > 2 else 1
    k, lag, base, mass, mesh_mass = mesh_period(program)
    mesh_c = 2 * DAMPING_RATIO * math.sqrt(k.mean() * mesh_mass)
    mesh_hz = SHAFT_HZ * TEETH[0]
    k, lag = np.append(k, k[0]), np.append(lag, lag[0])
    lag_rate = np.gradient(lag) * (len(lag) - 1) * mesh_hz
    par = (mesh_hz, mesh_mass, mesh_c, TORQUE / base[0], mass[0], mass[1])
    step = 1 / (SAMPLES_A_PERIOD * STEPS_A_SAMPLE * mesh_hz)
    integrate(10, step, k, lag, lag_rate, par)

    # The heavily damped supports return slowest.
    settling_s = SETTLING_NEPERS * SUPPORT_C / SUPPORT_K
    steps = MEMBERS * DEPTHS * (settling_s + PERIODS / mesh_hz) / step
    for _ in range(runs):
        start = time.process_time()
        state = integrate(STEPS, step, k, lag, lag_rate, par)
        a_step = (time.process_time() - start) / STEPS
        assert np.isfinite(state).all()
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        with tempfile.TemporaryDirectory() as folder:
            start = time.time()
            subprocess.run([program, "evaluate", "--leave-one-out", "1", "--data-dir", folder], check=True, capture_output=True)
            wall = time.time() - start
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        spent = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
        print(f"Numba: {1e6 * a_step:.2f} µs a step, {a_step * steps:.0f} s for {steps / 1e6:.0f} million steps; "
              f"the program: {spent:.0f} s of processor time, {wall:.0f} s of wall-clock time; ratio {a_step * steps / spent:.1f}")


if __name__ == "__main__":
    main()
