# %% [markdown]
# # From a film to a model that can be pushed
#
# We film a small rocker, fit a simulation to the film, compare both, and push the simulation at a point of
# its image. The film is simulated, so that everything here can be run again.

# %%
import cv2
import matplotlib.pyplot as plt
import numpy as np
import torch

import lagsplat

# %% [markdown]
# ## A film
#
# The package can simulate recordings. This one is a rocker in front of shelves, in tiny pictures. We
# keep only its frames, as a video file: 30 frames a second, without loss.

# %%
made = lagsplat.simulate_recording("profile=toy", "system=toy_swing")
size = (made.width, made.height)
writer = cv2.VideoWriter("swing.avi", cv2.VideoWriter.fourcc(*"FFV1"), 30.0, size)
for frame in made.frames:
    writer.write(frame[..., ::-1])  # OpenCV has blue first
writer.release()

# %% [markdown]
# From here on, a video of your own takes the same way. The last 30 frames are held out: no fit sees them.

# %%
split = ("recording.split.train_fraction=null", "recording.split.held_out_frames=30")
film = lagsplat.read_recording("swing.avi", *split)
figure, axes = plt.subplots(1, 5, figsize=(7, 1.4), layout="constrained")
for axis, k in zip(axes, range(0, 15, 3), strict=True):
    axis.imshow(film.frames[k])
    axis.set_title(f"{film.time_s[k]:.2f} s", fontsize="small")
    axis.axis("off")
figure.savefig("film.png")

# %% [markdown]
# ![Five frames of the film](film-to-pushable-model/film.png)
#
# The rocker swings to and fro in about half a second.
#
# ## The fit
#
# Stage 1 learns an encoder, from a frame to a state, and Gaussians, from a state to a frame. Stage 2 learns
# the equations of motion of that state. Profile `toy` takes seconds; use `quick` for a video of your own.

# %%
experiment = lagsplat.compose(
    "profile=toy", "system=toy_swing", "recording=filmed", "recording.kind=video", "recording.path=swing.avi"
)
run = lagsplat.fit_run(experiment, out="run")

# %% [markdown]
# The command line does the same: `lagsplat fit out=run profile=toy system=toy_swing recording=filmed
# recording.kind=video recording.path=swing.avi`.
#
# ## The simulation beside the film
#
# A rollout gets the state and the velocity of one frame, and from there on nothing of the film. We start it
# five frames before the held-out part.

# %%
start = run.recording.n_train - 5
encoded, time_s = run.chart.latents[start:], run.recording.time_s[start:]
states, _ = lagsplat.rollout(run, np.zeros((len(time_s), 0)), frame=start)
miss = float(np.sqrt(np.mean((states - encoded) ** 2)) / encoded.std())
figure, axis = plt.subplots(figsize=(7, 2.5), layout="constrained")
axis.plot(run.recording.time_s, run.chart.latents[:, 0], ".", color="0.6", label="encoded film")
axis.plot(time_s, states[:, 0], "C0", label="rollout")
axis.axvspan(
    run.recording.time_s[run.recording.n_train], time_s[-1], color="C1", alpha=0.15, label="held out"
)
axis.set(xlabel="time [s]", ylabel="state [1]", ylim=(-2, 2.8), title=f"miss: {miss:.0%} of the motion")
axis.legend(ncols=3, fontsize="small", loc="upper left")
figure.savefig("rollout.png")

# %% [markdown]
# ![State of the encoded film and of the rollout over time](film-to-pushable-model/rollout.png)
#
# Grey dots are the film, one state a frame. The line is the simulation. In the shaded part no fit saw the
# dots, and the line still goes through them. The miss is the rms distance from line to dots, as a share of
# their standard deviation.
#
# The same as frames:

# %%
point = lagsplat.hold(run)
drawn = point.render_images(torch.from_numpy(states))
rows = {"film": film.frames[start:] / 255, "rollout": drawn}
rows["difference"] = np.abs(rows["film"] - drawn).mean(axis=-1)
figure, axes = plt.subplots(3, 5, figsize=(7, 3.4), layout="constrained")
for row, (name, pictures) in zip(axes, rows.items(), strict=True):
    for axis, k in zip(row, range(0, len(time_s), 7), strict=True):
        axis.imshow(np.clip(pictures[k], 0, 1), cmap="magma", vmin=0, vmax=0.5)
        axis.set(xticks=[], yticks=[])
        if row is axes[0]:
            axis.set_title(f"{time_s[k] - time_s[0]:.2f} s", fontsize="small")
    row[0].set_ylabel(name)
figure.savefig("frames.png")

# %% [markdown]
# ![Frames of the film, of the rollout, and their difference](film-to-pushable-model/frames.png)
#
# Black means no difference; the brightest colour of the scale would be half of the range from black to
# white. What is left lies along the edges of the rocker.
#
# ## A push
#
# A force acts on the image. We push where the image moves most, along the direction in which it moves, hold
# the force for one second, and let go.

# %%
at, along = lagsplat.find_lever(run)
pushed, _ = lagsplat.push(run, at, along, share=0.5, hold_s=1.0, duration_s=4.0)
clock = run.chart.dt_s * np.arange(len(pushed))
pushed_away = float(np.abs(pushed - pushed[0]).max())
figure, axes = plt.subplots(1, 2, figsize=(7, 2.5), layout="constrained", width_ratios=[1, 2])
axes[0].imshow(np.clip(point.render_images(point.rest[None], scale=4)[0], 0, 1), extent=(0, *size, 0))
axes[0].annotate(
    "", np.add(at, 8 * np.array(along)), at, arrowprops={"color": "C1", "width": 2, "headwidth": 7}
)
axes[0].set(xlim=(0, size[0]), ylim=(size[1], 0), title="the force", xticks=[], yticks=[])
axes[1].plot(clock, pushed[:, 0] - pushed[0, 0])
axes[1].axvspan(0, 1, color="C1", alpha=0.15, label=f"force acts; {pushed_away:.2f} away at most")
axes[1].set(xlabel="time [s]", ylabel="away from rest [1]")
axes[1].legend(fontsize="small")
figure.savefig("push.png")

# %% [markdown]
# ![The force in the image, and the motion that follows](film-to-pushable-model/push.png)
#
# While the force acts, the rocker swings about a displaced rest. Once it is let go, it swings about its own
# rest again, a little less with each swing. Nobody ever pushed it in the film: the answer comes from the
# learned equations. Its frames:

# %%
moments = [0.0, 0.23, 0.47, 1.27, 1.5]
shown = point.render_images(torch.from_numpy(pushed[[round(t / run.chart.dt_s) for t in moments]]), scale=4)
figure, axes = plt.subplots(1, 5, figsize=(7, 1.4), layout="constrained")
for axis, picture, t in zip(axes, shown, moments, strict=True):
    axis.imshow(np.clip(picture, 0, 1))
    axis.set_title(f"{t:.2f} s", fontsize="small")
    axis.axis("off")
figure.savefig("pushed.png")

# %% [markdown]
# ![Five frames of the pushed rocker](film-to-pushable-model/pushed.png)
#
# They are drawn four times as large as the film: no Gaussian is tied to a pixel.
#
# ## One page to keep

# %%
lagsplat.export_page("run", "run.html")

# %% [markdown]
# The page holds the whole simulation and needs no server: [open it and pull the
# rocker](film-to-pushable-model/run.html). A rocker fitted by profile `quick` looks [like
# this](../../results/published/pages/rainbow_rocker.html).
#
# [Push a model in its image](../how-to/push-in-image.md) says how far to trust such an answer.
