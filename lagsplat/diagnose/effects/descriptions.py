"""Every name that a diagnosis may give, in words that need no training in mechanics."""

from dataclasses import dataclass
from typing import Literal

Kind = Literal["parameter", "mechanism", "outside", "observation", "verdict"]


@dataclass(frozen=True)
class Words:
    """One name: ``title`` goes on "the cause is ..."; ``what`` it is, how it is ``seen``, what to ``do``.

    ``kind`` is "parameter" for a number of the sim that is off, "mechanism" for physics that the sim lacks,
    "outside" for what acts on the mechanism from elsewhere, "observation" for camera and clock.
    """

    title: str
    kind: Kind
    what: str
    seen: str
    do: str


WORDS: dict[str, Words] = {
    "none": Words(
        "nothing",
        "verdict",
        "The simulation and the recording agree as well as noise and the simulation's own uncertainty allow.",
        "The forecasts miss by no more than the true model would.",
        "Keep the simulation as it is.",
    ),
    "unknown": Words(
        "something that is not in the catalogue",
        "verdict",
        "A gap is there, and no effect of the catalogue explains it.",
        "Even the best candidate leaves more than noise behind.",
        "Look at where the residual acts, in time and along the motion, before anything is added.",
    ),
    "viscous_damping": Words(
        "another viscous damping than the simulation's",
        "parameter",
        "A resistance in proportion to speed is stronger or weaker than in the simulation.",
        "Swings die away faster or slower than predicted, by the same share at every size.",
        "Set the simulation's damping anew.",
    ),
    "linear_stiffness": Words(
        "another stiffness than the simulation's",
        "parameter",
        "What pulls the mechanism back to rest is stronger or weaker than in the simulation.",
        "It swings at another frequency, and a steady load deflects it by another amount.",
        "Set the simulation's stiffness anew.",
    ),
    "mass_change": Words(
        "another mass than the simulation's",
        "parameter",
        "The mechanism is heavier or lighter than in the simulation, by a payload for instance.",
        "It swings at another frequency and fades at another rate, yet rests where it should.",
        "Weigh the payload, or set the simulation's inertia anew.",
    ),
    "constant_force": Words(
        "a constant force or a tilt",
        "parameter",
        "A steady pull unknown to the simulation: a tilted base, a preload, an offset of an actuator.",
        "The mechanism comes to rest somewhere else than predicted.",
        "Level the base, take out the offset, or add it to the simulation.",
    ),
    "input_gain": Words(
        "another strength of an input",
        "parameter",
        "The actuator pushes more or less for the same command than in the simulation, or not at all.",
        "Every response to that input is too large or too small by the same factor.",
        "Calibrate the actuator, or set its gain in the simulation anew.",
    ),
    "cubic_stiffness": Words(
        "a spring that hardens or softens",
        "parameter",
        "The pull back to rest grows faster, or slower, than the deflection.",
        "The frequency depends on how far it swings, while small swings are predicted well.",
        "Give the simulation's potential a term of fourth order.",
    ),
    "coulomb_friction": Words(
        "dry friction",
        "mechanism",
        "A rubbing contact resists with the same force at every speed, however slow.",
        "Swings shrink by the same amount each time, and it stops short of its rest position.",
        "Add dry friction to the simulation, or look after the bearings and seals.",
    ),
    "stribeck_friction": Words(
        "dry friction that sticks",
        "mechanism",
        "A rubbing contact holds harder at rest than it resists while sliding.",
        "Slow motion goes in jerks: it sticks, breaks loose and slips.",
        "Add friction that falls with speed to the simulation, or lubricate.",
    ),
    "load_dependent_friction": Words(
        "friction that grows with load",
        "mechanism",
        "A bearing or gear rubs more the harder it is pressed.",
        "Losses differ between poses, or between weak and strong inputs, at equal speed.",
        "Let the simulation's friction depend on the load that the joint carries.",
    ),
    "quadratic_drag": Words(
        "drag of air or water",
        "mechanism",
        "A resistance that grows with the square of speed.",
        "Large swings die away quickly, small ones hardly at all.",
        "Add a quadratic drag to the simulation.",
    ),
    "input_lag": Words(
        "an actuator that follows its command slowly",
        "mechanism",
        "What the actuator does creeps up to what it is told, as a filling chamber does.",
        "Steps are answered gently, and fast commands are answered weakly and late.",
        "Put a first-order filter before that input of the simulation.",
    ),
    "input_delay": Words(
        "a delay of an input",
        "mechanism",
        "The actuator does what it is told, a fixed time later.",
        "Nothing happens for a moment after each step, then everything as predicted.",
        "Delay that input in the simulation, or find the wait in the communication.",
    ),
    "input_dead_zone": Words(
        "a dead zone of an input",
        "mechanism",
        "Commands below a threshold do nothing, as with a valve that opens late.",
        "Small commands move nothing, and each passage through zero brings a pause.",
        "Put a dead zone before that input, or compensate it in the controller.",
    ),
    "input_saturation": Words(
        "an actuator at its limit",
        "mechanism",
        "Above some command the actuator gives no more.",
        "Weak commands are answered as predicted, strong ones too weakly.",
        "Limit that input of the simulation, or command less.",
    ),
    "input_backlash": Words(
        "play between actuator and mechanism",
        "mechanism",
        "After each reversal of the command some travel is lost before anything moves.",
        "The response lags by the same amount of command in both directions.",
        "Put play before that input of the simulation, or take up the slack.",
    ),
    "hysteresis": Words(
        "hysteresis",
        "mechanism",
        "The force depends on the way by which a position was reached, not on speed.",
        "Loading and unloading follow two curves, however slowly it is done.",
        "Add an internal state of Bouc-Wen type to the simulation.",
    ),
    "creep": Words(
        "creep of a soft material",
        "mechanism",
        "The material yields slowly under load and recovers slowly afterwards.",
        "After a step it keeps moving for long, and losses peak at one rate of motion.",
        "Add a spring in series with a dashpot to the simulation.",
    ),
    "joint_backlash": Words(
        "free play in a joint",
        "mechanism",
        "Around its rest position the joint is loose and nothing pulls it back.",
        "Small swings are slower than large ones, down to no pull at all.",
        "Add the gap to the simulation's potential, or tighten the joint.",
    ),
    "end_stop": Words(
        "a stop or a contact on one side",
        "mechanism",
        "Beyond some position the mechanism runs into something stiff.",
        "Motion is cut off on one side only, with a sudden turn.",
        "Add the stop to the simulation, or clear what is in the way.",
    ),
    "external_push": Words(
        "a push that nobody logged",
        "outside",
        "Something or somebody touched the mechanism for a moment.",
        "The forecast is right before and after, and wrong across one instant.",
        "Leave that stretch out, or give the push to the simulation as an input.",
    ),
    "external_periodic_force": Words(
        "a vibration from outside",
        "outside",
        "Something shakes the mechanism at a steady frequency, such as a motor or the floor.",
        "One frequency stands out that no input explains, even at rest.",
        "Find and stop its source, or add it to the simulation.",
    ),
    "parameter_drift": Words(
        "a property that changes slowly",
        "outside",
        "Something warms up, wears or leaks while the recording lasts.",
        "The simulation fits early and fails late, for the same motion.",
        "Record after warming up, or let that parameter depend on time.",
    ),
    "hidden_mode": Words(
        "a part that swings along and that the simulation does not have",
        "mechanism",
        "A loose or flexible part moves on its own and pulls on the rest.",
        "A second frequency appears, and energy leaves and comes back.",
        "Give the simulation one more coordinate, or fasten the part.",
    ),
    "time_offset": Words(
        "clocks of motion and inputs that disagree",
        "observation",
        "The log of the inputs is shifted in time against the motion.",
        "All responses start too early or too late by the same time; the physics is right.",
        "Shift one clock by the offset; leave the simulation alone.",
    ),
    "time_jitter": Words(
        "time stamps that scatter",
        "observation",
        "Frames are stamped a little early or late at random.",
        "Errors are large where motion is fast and vanish where it turns.",
        "Use the camera's own time stamps; leave the simulation alone.",
    ),
    "frame_drops": Words(
        "lost or repeated frames",
        "observation",
        "Some frames are missing or shown twice, and the clock does not say so.",
        "The motion halts or leaps for single frames.",
        "Record again without losses, or cut there; leave the simulation alone.",
    ),
    "camera_change": Words(
        "a camera that was moved or zoomed",
        "observation",
        "The picture was taken from another place or with another zoom than the simulation was learnt from.",
        "Everything appears shifted or stretched, at rest as well; the background is too.",
        "Put the camera back or calibrate it; leave the simulation alone.",
    ),
    "camera_drift": Words(
        "a camera that moves slowly",
        "observation",
        "The camera sinks or turns while the recording lasts.",
        "The rest position wanders, and the background with it.",
        "Fix the camera or stabilise the film; leave the simulation alone.",
    ),
    "exposure_blur": Words(
        "a long exposure",
        "observation",
        "Each frame is a mean over the time the shutter is open.",
        "Fast turns look smaller than they are.",
        "Shorten the exposure; leave the simulation alone.",
    ),
}  # fmt: skip


def words_of(name: str) -> Words:
    """The words for ``name``.

    Raises:
        ValueError: a name that no diagnosis gives.
    """
    if name not in WORDS:
        raise ValueError(f"no effect is called {name!r}; known are {', '.join(WORDS)}")
    return WORDS[name]


def short_title(name: str) -> str:
    """The name itself as people write it: ``coulomb_friction`` is "Coulomb friction"."""
    plain = name.replace("_", " ")
    return plain.replace("coulomb", "Coulomb").replace("stribeck", "Stribeck")
