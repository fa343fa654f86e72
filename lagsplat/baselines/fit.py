"""Train a baseline on a recording, or take its published weights; its loss, optimiser and schedule.

The schedule is in fractions of the run, so that a short run has the same stages as the published 300 epochs:
warm-up and the early weight are the first five, the drop follows the two hundredth.
"""

import logging
import math
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from jaxtyping import Float32
from torch.nn import functional

from lagsplat.array_types import Images, Inputs, Latents, Scalar
from lagsplat.baselines import networks
from lagsplat.baselines.config import BaselineConfig, BaselineLossConfig, BaselineRateConfig
from lagsplat.baselines.model import UNDECAYED, Baseline, BaselineArchitecture, Oscillators, stack_delays
from lagsplat.baselines.released import load_released
from lagsplat.baselines.validation import ForecastValidation, WeightSelection, count_trained_frames
from lagsplat.io.files.checkpoint import load_training_state, save_training_state
from lagsplat.io.recording.recording import Recording
from lagsplat.stage1.autoencoder import to_images
from lagsplat.stage1.training import run_training

log = logging.getLogger(__name__)
PATIENCE = 10  # maximum number of consecutive batches without a finite gradient


class BaselineCurvePoint(NamedTuple):
    """Means since the previous point; ``seconds`` is the total training time without interruptions.

    ``validation`` is the error of the last forecasts that were checked, NaN before the first.
    """

    step: int
    loss: float
    reconstruction: float
    divergence: float
    ahead: float
    latent: float
    steady: float
    attention: float
    closing: float
    validation: float
    seconds: float


def choose_architecture(config: BaselineConfig, recording: Recording) -> BaselineArchitecture:
    """The architecture of a baseline for this recording."""
    return BaselineArchitecture(
        decoder=config.decoder,
        dynamics=config.dynamics,
        d=config.d,
        n_inputs=recording.inputs.shape[1],
        samples=config.samples,
        height=recording.height,
        width=recording.width,
        dt_s=recording.dt_s,
        background=config.background,
        noise=config.noise,
    )


def fit_baseline(
    train: Recording,
    config: BaselineConfig,
    *,
    seed: int,
    checkpoint: Path | None = None,
    identity: str = "",
) -> tuple[Baseline, list[BaselineCurvePoint]]:
    """Train a baseline on the training part of a recording.

    Every random draw is a function of the seed and the step, so a run resumed from ``checkpoint`` ends with
    the same bits as an uninterrupted one; ``identity`` identifies the run in that file. The dynamics step
    once per median frame spacing. Where a part is withheld (``config.validation``), the weights are those
    whose forecasts of it were best, else the last.

    Raises:
        ValueError: no clip is as long as a batch, the inputs or the frames do not suit the models.
        FloatingPointError: the gradient is not finite for `PATIENCE` batches in a row. The encoder's
            variance is unbounded and can overflow; such a batch is skipped and logged.

    Source: the published runs trained for 300 passes.
    """
    fit = BaselineFit(train, config, seed)
    model, optimizer = fit.selection, fit.optimizer
    curve = load_training_state(checkpoint, model, optimizer, BaselineCurvePoint, identity=identity)
    run_training(
        fit.take_step,
        curve,
        BaselineCurvePoint,
        n_steps=config.n_steps,
        n_terms=len(BaselineCurvePoint._fields) - 2,
        title="baseline",
        save=partial(save_training_state, checkpoint, model, optimizer, curve, identity=identity),
        save_every_s=config.checkpoint_every_s,
        ends=[config.n_steps],
    )
    return (model.current if fit.validation is None else model.best).eval(), curve


class BaselineFit:
    """A baseline in training on batches of consecutive frames, cut clip by clip without shorter remainders.

    Raises:
        ValueError: no clip is as long as a batch, the inputs or the frames do not suit the models.
    """

    def __init__(self, train: Recording, config: BaselineConfig, seed: int) -> None:
        if not train.inputs.shape[1]:
            raise ValueError(
                f"recording {train.meta.get('source')}: no inputs, but the baselines are driven models; "
                "leave this system out of the baselines"
            )
        n_frames = count_trained_frames(train, config.validation)
        clips = [(a, min(b, n_frames)) for a, b in train.segments]
        starts = [np.arange(a, b - config.batch + 1, config.batch) for a, b in clips]
        if not sum(map(len, starts)) or config.rest_frames > n_frames:
            raise ValueError(
                f"recording {train.meta.get('source')}: {n_frames} training frames in "
                f"{len(train.segments)} clip(s) hold no batch of {config.batch} frames or no "
                f"{config.rest_frames} frames at rest; lower baseline.batch or baseline.rest_frames"
            )
        delayed = stack_delays(train.inputs, samples=config.samples, segments=train.segments)
        self.frames = torch.from_numpy(np.array(train.frames))  # a copy: the file is mapped read-only
        self.inputs = torch.from_numpy(delayed.astype(np.float32))
        self.starts = np.concatenate(starts).astype(np.int64)
        self.config, self.seed, self.lost = config, seed, 0
        self.validation = (
            ForecastValidation(train, self.frames, self.inputs, config.validation, first=n_frames)
            if config.validation.share
            else None
        )
        torch.manual_seed(seed)
        self.baseline = Baseline(choose_architecture(config, train))
        self.selection = WeightSelection(self.baseline)
        self.optimizer = make_baseline_optimizer(self.baseline, config.rate)

    def take_step(self, step: int) -> Float32[np.ndarray, " terms"] | None:
        """One step of the training, see `train_step`, which may fail fewer than `PATIENCE` times in a row."""
        set_rates(self.optimizer, self.config.rate, step=step, steps=self.config.n_steps)
        terms = self.train_step(step)
        self.lost = self.lost + 1 if terms is None else 0
        if self.lost >= PATIENCE:
            raise FloatingPointError(
                f"the baseline diverged before step {step}: {self.lost} batches in a row have no "
                "finite gradient. Lower baseline.rate.peak or look for broken frames with `lagsplat inspect`"
            )
        if self.lost:
            log.warning("step %d: the gradient is not finite, nothing is learned from this batch", step)
        self.validate(step + 1)
        return None if terms is None else np.append(terms, np.float32(self.selection.error))

    def validate(self, step: int) -> None:
        """Check the forecasts where it is time, after ``step`` steps; keep the weights if they are best."""
        every = max(1, self.config.n_steps // self.config.validation.checks)
        if self.validation is not None and (step % every == 0 or step == self.config.n_steps):
            self.selection.update(self.validation.measure_error(self.baseline))

    def train_step(self, step: int) -> Float32[np.ndarray, " terms"] | None:
        """One gradient step: the loss and its unweighted terms, or None without a finite gradient."""
        config, rng = self.config, np.random.default_rng([self.seed, step])
        generator = torch.Generator().manual_seed(int(rng.integers(2**62)))
        start = self.choose_start(step)
        frames = slice(start, start + config.batch)
        at_rest = rng.permutation(config.rest_frames)[: config.batch]
        moving = (to_images(self.frames[frames]), self.inputs[frames])
        scene = BaselineBatch(*moving, to_images(self.frames[at_rest]), self.inputs[at_rest])
        self.optimizer.zero_grad(set_to_none=True)
        share = config.loss.closing_gradient
        terms = compute_loss_terms(self.baseline, scene, generator=generator, closing_gradient=share)
        closing = closing_term_weight(config.loss, step=step, steps=config.n_steps)
        loss = total_loss(terms, config.loss, closing=closing)
        loss.backward()
        norm = torch.nn.utils.clip_grad_norm_(self.baseline.parameters(), config.rate.gradient_clip)
        if not torch.isfinite(norm):
            return None
        self.optimizer.step()
        return torch.stack([loss, *terms]).detach().numpy()

    def choose_start(self, step: int) -> int:
        """First frame of this step's batch: in order, or in a new order on every pass."""
        turn, place = divmod(step, len(self.starts))
        if self.config.order == "sequential":
            return int(self.starts[place])
        order = np.random.default_rng([self.seed, turn, len(self.starts)])
        return int(order.permutation(self.starts)[place])


def obtain_baseline(
    train: Recording, config: BaselineConfig, *, seed: int, checkpoint: Path, identity: str
) -> tuple[Baseline, dict[str, Any]]:
    """The model, trained or from published weights, and facts for its header.

    These are ``steps``, ``frames_seen`` and ``wall_s`` (None if not trained here), ``weights`` (the file, or
    None), ``epoch`` of published weights, and ``curve``, a list of rows.

    Raises:
        ValueError: as `fit_baseline` and `load_released`, or weights of another model than configured.
        FloatingPointError: as `fit_baseline`.
    """
    if config.weights is None:
        baseline, curve = fit_baseline(train, config, seed=seed, checkpoint=checkpoint, identity=identity)
        rows = [point._asdict() for point in curve]
        spent = {"steps": config.n_steps, "frames_seen": config.n_steps * config.batch}
        return baseline, {**spent, "wall_s": curve[-1].seconds, "weights": None, "epoch": None, "curve": rows}
    baseline, epoch = load_released(config.weights)
    loaded = baseline.architecture
    if (loaded.decoder, loaded.dynamics) != (config.decoder, config.dynamics):
        raise ValueError(
            f"{config.weights}: holds {loaded.dynamics} with {loaded.decoder}, but {config.dynamics} with "
            f"{config.decoder} are wanted; choose with baselines=[...], or give a folder with "
            "SYSTEM/BASELINE.pt"
        )
    unknown = dict.fromkeys(("steps", "frames_seen", "wall_s"))
    return baseline, {**unknown, "weights": str(config.weights), "epoch": epoch, "curve": []}


class BaselineBatch(NamedTuple):
    """Consecutive frames with their delayed inputs, and frames at rest with theirs."""

    images: Images
    inputs: Inputs
    rest_images: Images
    rest_inputs: Inputs


class BaselineLossTerms(NamedTuple):
    """The unweighted terms of the loss, all means; those that a model lacks are zero."""

    reconstruction: Scalar
    divergence: Scalar
    ahead: Scalar
    latent: Scalar
    steady: Scalar
    attention: Scalar
    closing: Scalar


def compute_loss_terms(
    baseline: Baseline,
    scene: BaselineBatch,
    *,
    generator: torch.Generator | None,
    closing_gradient: float = 1.0,
) -> BaselineLossTerms:
    """Every loss term for one batch; without a ``generator`` latents are means and maps have no noise.

    The encoded velocity is a constant for the dynamics and their targets; gradients flow through it only to
    the attention maps. ``closing_gradient`` is the share of the closing term's gradient that reaches them.
    """
    dt_s = baseline.architecture.dt_s
    # central differences, one-sided at both ends [1/s]
    (rates,) = torch.gradient(scene.images, spacing=dt_s, dim=0)
    mean, log_variance, moving = baseline.encoder.moving(scene.images, rates)
    velocity = moving.detach()
    later, later_velocity = baseline.dynamics(mean, velocity, scene.inputs)
    attention = closing = steady = mean.new_zeros(())
    if isinstance(baseline.decoder, networks.AttentionDecoder):
        attention, closing = _attention_terms(baseline.decoder, mean, moving, rates, closing_gradient)
    if isinstance(baseline.dynamics, Oscillators):
        steady = _steady_term(baseline.dynamics, baseline.encoder(scene.rest_images)[0], scene.rest_inputs)
    drawn = mean
    if generator is not None:
        drawn = mean + (0.5 * log_variance).exp() * torch.randn(mean.shape, generator=generator)
    pictures = baseline.decoder(drawn, generator=generator)
    return BaselineLossTerms(
        reconstruction=functional.mse_loss(pictures, scene.images),
        divergence=-0.5 * (1.0 + log_variance - mean.square() - log_variance.exp()).mean(),
        ahead=functional.mse_loss(baseline.decoder(later[:-1], generator=generator), scene.images[1:]),
        latent=functional.mse_loss(later[:-1], mean[1:])
        + dt_s**2 * functional.mse_loss(later_velocity[:-1], velocity[1:]),
        steady=steady,
        attention=attention,
        closing=closing,
    )


def _steady_term(law: Oscillators, z: Latents, u: Inputs) -> Scalar:
    """Distance of frames at rest from the rest of the law, and their motion in one step from standstill."""
    later, velocity = law(z, torch.zeros_like(z), u)
    off = (z - law.rest).square().mean() + (later - law.rest).square().mean()
    return off + law.dt_s**2 * velocity.square().mean()


def _attention_terms(
    decoder: networks.AttentionDecoder, z: Latents, velocity: Latents, rates: Images, share: float
) -> tuple[Scalar, Scalar]:
    maps, map_rates = torch.func.jvp(decoder.maps, (z,), (velocity,))[:2]
    attention = networks.penalize_unwarranted_change(map_rates, rates)
    if decoder.group != 2:
        return attention, z.new_zeros(())
    # the same values with a share of their gradient
    seen, seen_rates = (share * value + (1.0 - share) * value.detach() for value in (maps, map_rates))
    centres = networks.compute_moving_centres(seen, seen_rates, decoder.places)
    nodes = (z.unflatten(1, (-1, 2)), velocity.detach().unflatten(1, (-1, 2)))
    return attention, networks.measure_disagreement(
        networks.compute_closing_rates(*nodes), networks.compute_closing_rates(*centres)
    )


def total_loss(terms: BaselineLossTerms, weights: BaselineLossConfig, *, closing: float) -> Scalar:
    """The weighted loss; ``closing`` is the present weight of that term."""
    return (
        terms.reconstruction
        + weights.divergence * terms.divergence
        + weights.ahead * terms.ahead
        + weights.latent * terms.latent
        + weights.steady * terms.steady
        + weights.attention * terms.attention
        + closing * terms.closing
    )


def make_baseline_optimizer(baseline: Baseline, config: BaselineRateConfig) -> torch.optim.AdamW:
    """AdamW with one parameter group per part of the model, and one without decay for logarithms."""
    groups = []
    for part in ("encoder", "decoder", "dynamics"):
        named = dict(getattr(baseline, part).named_parameters())
        for decays in (True, False):
            chosen = [value for name, value in named.items() if (name not in UNDECAYED) == decays]
            if chosen:
                decay = config.weight_decay if decays else 0.0
                groups.append({"params": chosen, "weight_decay": decay, "part": part})
    return torch.optim.AdamW(groups, lr=config.peak, foreach=True)


def set_rates(optimizer: torch.optim.Optimizer, config: BaselineRateConfig, *, step: int, steps: int) -> None:
    """Set the step sizes: warm-up in steps for the encoder and the dynamics, then one drop for all parts."""
    progress, warmup = step / steps, 1.0
    factor = config.drop_factor if progress >= config.drop_at + config.warmup else 1.0
    if progress < config.warmup:
        stair = math.floor(config.warmup_stairs * progress / config.warmup)
        warmup = config.warmup_start + (1 - config.warmup_start) * stair / config.warmup_stairs
    for group in optimizer.param_groups:
        warmed = group["part"] in ("encoder", "dynamics")
        group["lr"] = config.peak * (factor * warmup if warmed else factor)


def closing_term_weight(config: BaselineLossConfig, *, step: int, steps: int) -> float:
    """The present weight of the term that compares closing rates of nodes and maps."""
    return config.closing_early if step < config.closing_from * steps else config.closing
