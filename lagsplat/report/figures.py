"""The figures, by name."""

from lagsplat.report.curves import draw_curves as draw_curves
from lagsplat.report.equilibrium import draw_equilibrium as draw_equilibrium
from lagsplat.report.force_figure import draw_forces as draw_forces
from lagsplat.report.force_map import draw_force_map as draw_force_map
from lagsplat.report.force_space import draw_space_push as draw_space_push
from lagsplat.report.gallery import draw_attention as draw_attention
from lagsplat.report.gallery import draw_gallery as draw_gallery
from lagsplat.report.horizon import draw_horizon as draw_horizon
from lagsplat.report.inertia import draw_inertia as draw_inertia
from lagsplat.report.latents import draw_latents as draw_latents
from lagsplat.report.reconstruction import draw_reconstruction as draw_reconstruction
from lagsplat.report.rollout import Fine as Fine
from lagsplat.report.rollout import roll_out as roll_out
from lagsplat.report.rollout_figure import draw_rollout as draw_rollout
from lagsplat.report.sides import draw_sides as draw_sides
from lagsplat.report.style import save_figure as save_figure
