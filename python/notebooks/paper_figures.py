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
# Figure 8: contact points of one pair of teeth, worn and unworn.

# %%
figure, axes = plt.subplots()
for depth_um in depths_um:
    contact = pair.tooth_contact(depth_um)
    axes.plot(contact.phi1_rad, contact.alpha1_rad, label=f"{depth_um:.0f} µm")
axes.set(xlabel="φ₁ in rad", ylabel="α₁ in rad", title="Figure 8a")
axes.legend()

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
# Figure 17: the same with elastic load sharing, at two torques.

# %%
figure, axes = plt.subplots()
for torque_nm in (130.0, 1300.0):
    cycle = pair.mesh(contact="loaded", torque_nm=torque_nm, points=400)
    axes.plot(cycle.phi1_rad, 1e-6 * cycle.stiffness_n_per_m, label=f"{torque_nm:.0f} N·m")
axes.set(xlabel="φ₁ in rad", ylabel="stiffness in N/µm", title="Figure 17, perfect flanks")
axes.legend()

# %% [markdown]
# Figure 22: indicators over the wear states of a library.

# %%
library = flankwatch.Library.build(pair, states=25)
figure, axes = plt.subplots(3, sharex=True)
for axis, name in zip(axes, ["rms", "kurtosis", "omx"]):
    axis.plot(library.wear_um, library.indicator(name), ".-")
    axis.set_ylabel(name)
axes[-1].set_xlabel("greatest wear depth in µm")
