# %% [markdown]
# # From a MuJoCo arm and a log to a patched model
#
# An arm of two joints is modelled in MuJoCo, and someone forgot that the elbow rubs. A log of the real arm
# says so. We let the diagnosis find it, take the patched model, and forecast a second log with it.

# %%
from pathlib import Path

import matplotlib.pyplot as plt
import mujoco
import numpy as np
import pandas as pd

import lagsplat

# %% [markdown]
# ## Two models
#
# `arm.xml` is the simulation. `real.xml` differs in one number, the `frictionloss` of the elbow, and only
# plays the real arm: the diagnosis never sees it.

# %%
MODEL = """<mujoco>
  <option timestep="0.0005" integrator="implicitfast"><flag contact="disable"/></option>
  <worldbody><body>
    <joint name="shoulder" axis="0 1 0" damping="0.2" armature="0.02"/>
    <geom type="capsule" fromto="0 0 0 0 0 -0.3" size="0.03" mass="1.5"/>
    <body pos="0 0 -0.3">
      <joint name="elbow" axis="0 1 0" damping="0.1" armature="0.02" frictionloss="{friction}"/>
      <geom type="capsule" fromto="0 0 0 0 0 -0.25" size="0.025" mass="1.0"/>
    </body>
  </body></worldbody>
  <actuator>
    <motor name="shoulder_motor" joint="shoulder"/>
    <motor name="elbow_motor" joint="elbow"/>
  </actuator>
</mujoco>"""
Path("arm.xml").write_text(MODEL.format(friction=0.0))
Path("real.xml").write_text(MODEL.format(friction=0.05))

# %% [markdown]
# ## Two logs of the real arm
#
# A controller moves both joints along sums of sines. Each row of the log has the time, both angles with a
# little noise, and both torques, which hold until the next row.

# %%
JOINTS, MOTORS = ["shoulder", "elbow"], ["shoulder_motor", "elbow_motor"]
RATE_HZ, STEPS = 100, 20  # rows of the log a second, steps of MuJoCo a row


def record(seed, seconds=16.0):
    """Log of the real arm under a controller: t [s], angles [rad], torques [N m]."""
    model = mujoco.MjModel.from_xml_path("real.xml")
    data, rng = mujoco.MjData(model), np.random.default_rng(seed)
    hertz, phase = rng.uniform(0.4, 1.4, (2, 3)), rng.uniform(0, 2 * np.pi, (2, 3))
    rows = []
    for t in np.arange(0.0, seconds, 1 / RATE_HZ):
        aim = 0.25 * (np.sin(2 * np.pi * hertz * t + phase) - np.sin(phase)).sum(axis=1)
        data.ctrl[:] = [20.0, 8.0] * (aim - data.qpos) - [2.0, 0.6] * data.qvel
        rows.append([t, *(data.qpos + 2e-4 * rng.standard_normal(2)), *data.ctrl])
        mujoco.mj_step(model, data, STEPS)
    return pd.DataFrame(rows, columns=["t", *JOINTS, *MOTORS])


log, second_log = record(seed=1), record(seed=2)
log.to_csv("log.csv", index=False)
figure, axes = plt.subplots(2, 1, figsize=(7, 3.6), sharex=True, layout="constrained")
axes[0].plot(log.t, log[JOINTS], label=JOINTS)
axes[1].plot(log.t, log[MOTORS])
axes[0].set_ylabel("angle [rad]")
axes[1].set(xlabel="time [s]", ylabel="torque [N m]")
axes[0].legend(ncols=2, fontsize="small", loc="lower center", bbox_to_anchor=(0.5, 1.0), frameon=False)
figure.savefig("log.png")

# %% [markdown]
# ![Angles and torques of the first log](mujoco-arm/log.png)
#
# ## The gap
#
# We play the torques of the second log into the simulation. Every second it starts anew from the logged
# state. The difference to the logged angles is the error of its forecast.


# %%
def forecast(path, log):
    """Angles (T, 2) [rad] of a model under the torques of a log, begun anew every second."""
    model = mujoco.MjModel.from_xml_path(path)
    data, angles = mujoco.MjData(model), log[JOINTS].to_numpy()
    speeds, torques, out = np.gradient(angles, log.t, axis=0), log[MOTORS].to_numpy(), []
    for row in range(len(log)):
        if row % RATE_HZ == 0:
            data.qpos[:], data.qvel[:] = angles[row], speeds[row]
        out.append(data.qpos.copy())
        data.ctrl[:] = torques[row]
        mujoco.mj_step(model, data, STEPS)
    return np.array(out)


real, before = second_log[JOINTS].to_numpy(), forecast("arm.xml", second_log)
figure, axes = plt.subplots(2, 1, figsize=(7, 3.6), sharex=True, layout="constrained")
for i, axis in enumerate(axes):
    axis.plot(second_log.t, real[:, i], "k", label="real")
    axis.plot(second_log.t, before[:, i], "C1", label="arm.xml")
    axis.set_ylabel(f"{JOINTS[i]} [rad]")
axes[0].legend(ncols=2, fontsize="small", loc="lower center", bbox_to_anchor=(0.5, 1.0), frameon=False)
axes[1].set(xlabel="time [s]", xlim=(0, 8))
figure.savefig("gap.png")

# %% [markdown]
# ![Logged angles and forecasts of the unpatched model](mujoco-arm/gap.png)
#
# The simulated elbow swings too far at nearly every turn. The plot does not say why: too little damping, a
# lighter forearm or a stronger motor would look alike.
#
# ## Diagnose
#
# `max_coupled=1` asks for one joint at a time, the other moving as logged. The other settings narrow the
# search, so that this page runs in a minute: 4 effects are fitted in full instead of 12, each from one
# starting point. Leave them out for a robot of your own.

# %%
quick = {"families": 4, "starts": 1, "iterations": 6, "identify_iterations": 8}
columns = {"t": "t", "q0": "shoulder", "q1": "elbow", "u0": "shoulder_motor", "u1": "elbow_motor"}
diagnosis = lagsplat.diagnose(
    "arm.xml", "log.csv", out="diagnosis", columns=columns, input_hold="zoh", max_coupled=1, **quick
)
print(diagnosis)

# %% [markdown]
# The command line does it in full: `lagsplat diagnose sim=arm.xml real=log.csv out=diagnosis
# diagnose.max_coupled=1 diagnose.input_hold=zoh`, with the same `diagnose.columns`.
#
# ## Where, and which effect?

# %%
joints = diagnosis.checks["joints"]
candidates = sorted(diagnosis.candidates, key=lambda candidate: candidate.probability)[-5:]
figure, axes = plt.subplots(1, 2, figsize=(7, 2.8), layout="constrained")
for shift, name, colour in ((-0.2, "before", "C1"), (0.2, "after", "C0")):
    bars = axes[0].bar(
        np.arange(2) + shift, [100 * joint[name] for joint in joints], 0.4, label=name, color=colour
    )
    axes[0].bar_label(bars, fmt="{:.1f}", fontsize="small")
axes[0].set(xticks=[0, 1], xticklabels=[joint["joint"] for joint in joints], ylabel="forecast error [%]")
axes[0].margins(y=0.15)
axes[0].legend(fontsize="small", loc="upper left")
axes[1].barh([c.name.replace("_", " ") for c in candidates], [c.probability for c in candidates])
axes[1].set(xlim=(0, 1), xlabel="probability", title=f"at the {diagnosis.candidates[0].coordinate}")
figure.savefig("effects.png")

# %% [markdown]
# ![Gap of each joint, and the likeliest effects at the elbow](mujoco-arm/effects.png)
#
# Left: errors of the diagnosis's own forecasts, in per cent of the motion. With the elbow as logged the
# shoulder has no gap: its model is right. Right: the gap of the elbow is dry friction, by its name in the
# field, Coulomb friction.
#
# ## The patched model
#
# MuJoCo has a counterpart of this effect, so the diagnosis has written `patched.xml`, the model with the
# friction added.

# %%
paths = ["arm.xml", "diagnosis/patched.xml", "real.xml"]
friction = [mujoco.MjModel.from_xml_path(path).joint("elbow").frictionloss[0] for path in paths]
figure, axis = plt.subplots(figsize=(7, 2.0), layout="constrained")
bars = axis.barh(paths, friction, color=["C1", "C0", "0.3"])
axis.bar_label(bars, fmt="{:.3f}", padding=3)
axis.invert_yaxis()
axis.margins(x=0.15)
axis.set_xlabel("frictionloss of the elbow [N m]")
figure.savefig("patch.png")

# %% [markdown]
# ![Friction of the elbow in the three models](mujoco-arm/patch.png)
#
# Nobody told the diagnosis the lowest bar. Slow motions in which a joint sticks for long may be named
# Stribeck friction instead; MuJoCo has no counterpart of it, and no patch is written then. So the logs here
# move fast.
#
# ## Forecast the second log again
#
# The second log took no part in the diagnosis. So it is a fair test of the patch.

# %%
after = forecast("diagnosis/patched.xml", second_log)
exact = forecast("real.xml", second_log)
error_before, error_after, error_exact = (
    float(np.sqrt(np.mean((q - real) ** 2))) for q in (before, after, exact)
)
figure, axes = plt.subplots(2, 1, figsize=(7, 3.8), sharex=True, layout="constrained")
for i, axis in enumerate(axes):
    axis.plot(second_log.t, before[:, i] - real[:, i], "C1", label=f"arm.xml: rms {error_before:.4f} rad")
    axis.plot(second_log.t, after[:, i] - real[:, i], "C0", lw=3, label=f"patched.xml: {error_after:.4f} rad")
    axis.plot(second_log.t, exact[:, i] - real[:, i], "k--", lw=0.8, label=f"real.xml: {error_exact:.4f} rad")
    axis.set_ylabel(f"{JOINTS[i]} error [rad]")
axes[0].legend(ncols=3, fontsize="small", loc="lower center", bbox_to_anchor=(0.5, 1.0), frameon=False)
axes[1].set_xlabel("time [s]")
figure.savefig("errors.png")

# %% [markdown]
# ![Errors of forecasts of the second log, before and after the patch](mujoco-arm/errors.png)
#
# Each forecast starts anew every second. The orange errors grow until the next start, at both joints, since
# the elbow pulls the shoulder along. The blue ones stay near zero. The dashed line is the true model: even
# its forecasts miss a little, as the logged angles from which they start are noisy. That much is noise, not
# the model.
#
# [Diagnose a robot](../how-to/diagnose-robot.md) goes on with URDF files, ROS bags and arms of many joints.
