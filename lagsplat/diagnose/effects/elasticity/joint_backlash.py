"""Free play about rest: within ``gap`` of it the spring does not act."""

from lagsplat.diagnose.effects.base import ForceEffect
from lagsplat.diagnose.effects.parameters import EffectParameter, HalfNormal, log_normal
from lagsplat.diagnose.solvers.force_laws import compile_force_law


@compile_force_law
def force(t, s, v, spring, drive, memory, theta, d_memory):
    """Return ``share omega^2 clip(s, -gap, gap)``, which cancels a share of the spring within the gap."""
    return theta[0] * theta[2] * min(max(s, -theta[1]), theta[1])


EFFECT = ForceEffect(
    name="joint_backlash",
    group="D",
    number=3,
    component="conservative",
    equation="a = share omega^2 clip(s, -gap, gap)",
    parameters=(
        EffectParameter("share", "ratio", HalfNormal(1.0)),
        EffectParameter("gap", "coordinate", log_normal(0.2, 1.0), (0.05, 0.15, 0.4, 0.8)),
    ),
    needs="a decay through small amplitudes",
    law=force,
    constants=lambda scales, variant: (scales.stiffness,),
    mujoco="the force of a joint's spring is a polynomial, which has no flat part about rest.",
    title="free play in a joint",
    what="Around its rest position the joint is loose and nothing pulls it back.",
    symptom="Small swings are slower than large ones, down to no pull at all.",
    remedy="Add the gap to the simulation's potential, or tighten the joint.",
)
