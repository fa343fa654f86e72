# %% [markdown]
# # From two CSV files to a diagnosis
#
# We simulate a pendulum twice. The second one has dry friction in its hinge, and plays the real machine.
# The diagnosis sees two tables and must say what the first pendulum lacks.

# %%
import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from scipy.integrate import solve_ivp

import lagsplat

# %% [markdown]
# ## Make two recordings
#
# A motor drives the hinge with three sines. Without a drive the pendulum would come to rest, and a
# recording of rest teaches nothing. The angle has a little noise, as every encoder has.


# %%
def record(friction, seed):
    """Table of time [s], angle [rad] and torque over inertia [rad/s²] of a driven pendulum."""
    rng = np.random.default_rng(seed)
    phases = rng.uniform(0, 2 * np.pi, 3)
    t = np.arange(0.0, 20.0, 0.025)

    def torque(t):
        return sum(2.0 * np.sin(w * t + p) for w, p in zip((1.7, 3.1, 6.3), phases, strict=True))

    def rate(t, y):
        rub = friction * np.tanh(y[1] / 0.01)
        return [y[1], torque(t) - 16.0 * np.sin(y[0]) - 0.3 * y[1] - rub]

    angle = solve_ivp(rate, (0, 20), [0.3, 0.0], t_eval=t, rtol=1e-8, max_step=0.02).y[0]
    return pd.DataFrame({"t": t, "q0": angle + 0.002 * rng.standard_normal(len(t)), "u0": torque(t)})


sim, real = record(friction=0.0, seed=1), record(friction=0.6, seed=2)
sim.to_csv("sim.csv", index=False)
real.to_csv("real.csv", index=False)

# %% [markdown]
# Column `t` is the time, `q0` the angle, `u0` the input. That is all the diagnosis needs.

# %%
figure, axes = plt.subplots(2, 1, figsize=(7, 3.6), sharex=True, layout="constrained")
for name, table in (("sim.csv", sim), ("real.csv", real)):
    axes[0].plot(table.t, table.q0, label=name)
    axes[1].plot(table.t, table.u0, label=name)
axes[0].set_ylabel("angle [rad]")
axes[1].set(xlabel="time [s]", ylabel="input [rad/s²]")
axes[0].legend(ncols=2, loc="lower center", bbox_to_anchor=(0.5, 1.0), frameon=False)
figure.savefig("recordings.png")

# %% [markdown]
# ![Angle and input of both recordings over time](two-csv-files/recordings.png)
#
# Look at the two angles. They start alike and then differ, but so do the inputs. By eye nobody can tell
# whether the mechanisms differ at all.
#
# ## Diagnose
#
# The diagnosis learns the law of the pendulum in `sim.csv`. It then tries each effect of the
# [catalogue](../reference/effects.md) on `real.csv`: which one, added to the law, explains what was
# measured?

# %%
diagnosis = lagsplat.diagnose("sim.csv", "real.csv", out="diagnosis")
print(diagnosis)

# %% [markdown]
# The command line does the same: `lagsplat diagnose sim=sim.csv real=real.csv out=diagnosis`.
#
# ## Which effect?

# %%
candidates = sorted(diagnosis.candidates, key=lambda candidate: candidate.probability)[-6:]
figure, axis = plt.subplots(figsize=(7, 2.8), layout="constrained")
bars = axis.barh([c.name.replace("_", " ") for c in candidates], [c.probability for c in candidates])
axis.bar_label(bars, fmt="{:.0%}", padding=3)
axis.set(xlim=(0, 1.1), xlabel="probability")
figure.savefig("effects.png")

# %% [markdown]
# ![Probability of the six likeliest effects](two-csv-files/effects.png)
#
# Each bar is the probability of one explanation. Coulomb friction, the field's name for dry friction,
# stands first. Its relatives follow: they also rub, but depend on direction, speed or load as well.
# *Unknown* would be a cause outside of the catalogue; here nothing asks for one.
#
# ## How large is the gap?

# %%
gap = diagnosis.gap
errors = {
    "sim as given": gap.before,
    "sim refitted": gap.refit,
    "with friction": gap.after,
    "noise alone": gap.floor,
}
figure, axis = plt.subplots(figsize=(7, 2.6), layout="constrained")
bars = axis.bar(list(errors), [100 * error for error in errors.values()], color=["C1", "C1", "C0", "0.6"])
axis.bar_label(bars, fmt="{:.1f} %", padding=2)
axis.margins(y=0.15)
axis.set_ylabel("forecast error\n[% of the motion]")
figure.savefig("gap.png")

# %% [markdown]
# ![Error of forecasts before and after](two-csv-files/gap.png)
#
# A forecast starts from the measured state and runs for one natural period. It covers a part of the
# recording that no fit has seen. The second bar matters: other numbers in the same law, such as more
# damping, do not close the gap. Friction closes it, nearly down to the error that noise alone leaves.
#
# ## Forecasts before and after

# %%
figure, axes = plt.subplots(1, 3, figsize=(7, 2.5), sharey=True, layout="constrained")
for axis, block in zip(axes, diagnosis.blocks[:3], strict=True):
    axis.plot(block.time_s, block.real[:, 0], "k.", ms=3, label="real")
    axis.plot(block.time_s, block.sim[:, 0], "C1", label="sim")
    axis.plot(block.time_s, block.augmented[:, 0], "C0", label="with friction")
    axis.set_xlabel("time [s]")
axes[0].set_ylabel("angle [rad]")
axes[0].legend(fontsize="small")
figure.savefig("forecasts.png")

# %% [markdown]
# ![Three held-out forecasts with and without friction](two-csv-files/forecasts.png)
#
# The black dots are measured. The old law swings too far, since nothing rubs in it. The new law stays on
# the dots.
#
# ## How strong is it?

# %%
strength = next(iter(diagnosis.effects[0].parameters.values()))
figure, axis = plt.subplots(figsize=(7, 1.5), layout="constrained")
axis.plot([strength.low, strength.high], [0, 0], "C0", lw=6, alpha=0.4, label="90 % interval")
axis.plot(strength.value, 0, "C0o", label="estimate")
axis.axvline(0.6, color="k", ls="--", label="truth")
axis.set(yticks=[], xlabel="friction [rad/s²]", xlim=(0, 1))
axis.legend(ncols=3, fontsize="small", loc="upper left")
figure.savefig("strength.png")

# %% [markdown]
# ![Estimated friction with its interval, and the truth](two-csv-files/strength.png)
#
# The interval is what this recording can say. The truth, known here because we made the data, lies in it.
#
# The folder `diagnosis` holds `report.html` with all of this, and `augmented.safetensors`, the pendulum
# with the friction added. [Diagnose a sim-to-real gap](../how-to/diagnose.md) explains every file.
