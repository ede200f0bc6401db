# %% [markdown]
# # A run to failure: the estimate and the true wear
# The pair's library is simulated once. The estimate does not know the transmission path of the run.

# %%
import flankwatch
import matplotlib.pyplot as plt
import numpy as np

pair = flankwatch.Pair.shen2022()
library = flankwatch.Library.build(pair, states=25, seconds=1.0)
run = flankwatch.Run(
    pair, records=40, seconds=1.0, max_wear_um=200.0, wear_exponent=2.0, snr_db=20.0, interval_s=86_400.0
)
tracker = flankwatch.Tracker(library, baseline_records=10, limit_um=200.0)

# %%
truth, median, low, high = [], [], [], []
for record in run:
    wear = tracker.update(record.samples, record.rate_hz, record.time, torque_nm=record.torque_nm)["wear"]
    truth.append(record.wear_um)
    for values, name in ((median, "median_um"), (low, "low_um"), (high, "high_um")):
        values.append(wear.get(name, np.nan))
print(wear["reason"])

# %%
figure, axes = plt.subplots()
axes.fill_between(range(len(truth)), low, high, alpha=0.3, label="90 % interval")
axes.plot(median, label="median")
axes.plot(truth, "k--", label="truth")
axes.set(xlabel="record", ylabel="wear depth in µm")
axes.legend()
assert np.nanmax(median) > 100, "the wear is detected"
