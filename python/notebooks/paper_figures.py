# %% [markdown]
# # Figures 8, 15, 17 and 22 of Shen et al. 2022
# Contact points, mesh stiffness and indicators of the paper's pair, computed by the model.

# %%
import flankwatch
import matplotlib.pyplot as plt
import numpy as np

pair = flankwatch.Pair.shen2022()
depths_um = [0.0, 50.0, 100.0, 150.0]

# %% [markdown]
# Figure 8: mesh relationship of one pair of teeth, worn and unworn: (a) points of contact, (b) rotations.

# %%
figure, (points, rotations) = plt.subplots(1, 2, layout="constrained")
spans = []
for depth_um in depths_um:
    contact = pair.tooth_contact(depth_um)
    points.plot(contact.alpha1_rad, contact.alpha1_prime_rad, label=f"{depth_um:.0f} µm")
    rotations.plot(contact.phi1_rad, contact.phi2_rad)
    spans.append((np.ptp(contact.alpha1_rad), np.ptp(contact.phi1_rad)))
points.set(xlabel="α₁ in rad", ylabel="α₁′ in rad", title="Figure 8a")
rotations.set(xlabel="φ₁ in rad", ylabel="φ₂ in rad", title="Figure 8b")
points.legend()
assert np.all(np.diff(spans, axis=0) * [-1, 1] > 0), "wear shortens the range of α₁ and extends that of φ₁"

# %% [markdown]
# Figure 15: mesh stiffness over one mesh period, with the paper's contact rule.

# %%
figure, axes = plt.subplots()
means = []
for depth_um in depths_um:
    cycle = pair.mesh(depth_um, contact="threshold")
    means.append(cycle.mean_stiffness_n_per_m)
    axes.plot(cycle.phi1_rad, 1e-6 * cycle.stiffness_n_per_m, label=f"{depth_um:.0f} µm")
axes.set(xlabel="φ₁ in rad", ylabel="stiffness in N/µm", title="Figure 15")
axes.legend()
assert np.all(np.diff(means) < 0), "wear softens the mesh"

# %% [markdown]
# Figure 17: mesh stiffness of perfect flanks by both contact rules, and by finite elements. The table is a
# plane-strain model of the same pair at 1300 N·m (`fixtures/reference/mesh-stiffness-fe`).

# %%
table = np.genfromtxt(
    "../../fixtures/reference/mesh-stiffness-fe/K_perfect.csv", delimiter=",", names=True, encoding="utf-8"
)
period_rad = 2 * np.pi / pair.teeth[0]
greatest = {}
figure, axes = plt.subplots()
axes.plot(table["phi1_rad"], 1e-6 * table["K_touch_N_per_m"], "k.", label="finite elements")
for contact in ("threshold", "loaded"):
    cycle = pair.mesh(contact=contact, torque_nm=1300.0)
    axes.plot(cycle.phi1_rad, 1e-6 * cycle.stiffness_n_per_m, label=f"{contact} contact")
    stiffness = np.interp(table["phi1_rad"], cycle.phi1_rad, cycle.stiffness_n_per_m, period=period_rad)
    greatest[contact] = np.max(np.abs(stiffness / table["K_touch_N_per_m"] - 1))
axes.set(xlabel="φ₁ in rad", ylabel="stiffness in N/µm", title="Figure 17, perfect flanks")
axes.legend()
print({contact: f"{difference:.1%} from finite elements" for contact, difference in greatest.items()})
# Elastic load sharing agrees within 0.5 % (docs/model.md); the threshold rule switches pairs at once.
assert greatest["loaded"] < 0.006 < 0.2 < greatest["threshold"]

# %% [markdown]
# Figure 22: indicators over 26 wear states to 250 µm, every second state of the paper.

# %%
library = flankwatch.Library.build(pair, states=26, max_wear_um=250.0)
figure, axes = plt.subplots(3, sharex=True)
labels = {"rms": "RMS in m/s²", "kurtosis": "kurtosis", "omx": "OMX in m/s²"}
for axis, (name, label) in zip(axes, labels.items()):
    axis.plot(library.wear_um, library.indicator(name), ".-")
    axis.set_ylabel(label)
axes[0].set_title("Figure 22")
axes[-1].set_xlabel("greatest wear depth in µm")
