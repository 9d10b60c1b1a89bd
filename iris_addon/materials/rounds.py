"""Rounds of lamps and gloss, solved in turn on cached rays.

A glossy floor that is taken for diffuse makes the lamps it mirrors look stronger, and a lamp of the wrong strength
makes the floor look glossier. Each is therefore solved for again under the other.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..base.group_by import group_means
from ..base.progress import Progress
from ..base.random_streams import stream
from ..brdf.diffuse import grazing_gain
from ..brdf.ggx import layered_factor
from ..lighting.backdrop import SeenBackdrop
from ..lighting.common_lamps import solve_states
from ..lighting.hidden import OutsideKind
from ..lighting.lamp_radiance import LitState, PatchFit, mean_radiance, patch_weight
from ..lighting.patterned_lamps import with_patterns
from ..lighting.problem import LightProblem, Lights
from ..lighting.profiled_lamps import with_profiles
from ..lighting.screens import Shown, with_screens
from ..lighting.search import reconsider_lamps
from ..lighting.sun import Sun
from ..response.observations import Observations
from ..response.radiance import GroupRadiance, Linearised, group_radiance, raised_by_clipped
from ..surface.regions import joined_regions
from ..transport.glossy_bounce import GlossyBounce, trace_glossy_bounce
from ..transport.transport import LightMoments
from .gloss import GLOSS_LEVELS, GLOSS_RAYS, Gloss, GlossObservations, choose_observations, fit_gloss
from .lobes import LampAim, LobeRays, Scene, trace_lobes
from .shading import Shading
from .specular import rough_lobes, specular_lobes, subtract_specular
from .view_dependence import DiffuseChoice

BOUNCE_MAX_ROUGHNESS = 0.6
"""Roughness up to which light paths go on from a surface, as in IRIS."""
BALANCE_GLOSSY_ROUGHNESS = 0.5
"""Roughness below which a region counts as glossy in the light balance."""
BALANCE_GLOSSY_WEIGHT = 0.3
"""Factor on the weight of glossy regions in the light balance: their highlights leave a bias, not noise."""
SCAN_KNOWN_SPREAD = 0.02
"""Spread of normals on a scan at which half of their observations count: 1°."""


@dataclass(frozen=True)
class MaterialProblem:
    """What stays fixed over the rounds.

    Attributes:
        light: the lighting problem, with brightness as photos show it.
        observations: M means over the pixels of one photo on one patch.
        linear: their radiance with its bounds.
        mirrored: (M, 3) radiance that the reflected rays of each observation explain, see :func:`.mirrored_radiance`.
        observed: radiance per patch, specular light included, over the view factor of rough surfaces.
        region: (M,) region of each observation.
        schlick: (M,) Schlick's S of the angle between normal and camera.
        diffuse: the lobe of every diffuse surface.
        specular_rays: reflected rays per observation.
        backdrop: what photos show where the mesh has holes.
        in_file: (n_regions,) object of the mesh file that each region lies in; None if the file names none.
        scanned: (n_regions,) bool, regions of a scan; None without one.
    """

    light: LightProblem
    observations: Observations
    linear: Linearised
    mirrored: NDArray[np.float64]
    observed: GroupRadiance
    region: NDArray[np.int32]
    schlick: NDArray[np.floating]
    diffuse: DiffuseChoice
    specular_rays: int
    seed: int
    backdrop: SeenBackdrop
    in_file: NDArray[np.int32] | None = None
    scanned: NDArray[np.bool_] | None = None

    def shading(self, lights: Lights) -> Shading:
        """The irradiance of ``lights`` at the seen patches."""
        return Shading.under(lights, self.light, self.diffuse.lobe)

    def view_factor(
        self, shading: Shading, roughness: NDArray[np.floating], rows: NDArray[np.integer] | slice = slice(None)
    ) -> NDArray[np.float32]:
        """(..., m) view factor F_d of the observations ``rows``, equations (10), (11), for ``roughness`` (..., m)."""
        o = self.observations
        toward = self.light.samples.direction[o.sample[rows]]
        return shading.view_factor(o.patch[rows], roughness, self.schlick[rows], toward)

    def with_gloss(self, gloss: Gloss, moments: LightMoments | None = None) -> MaterialProblem:
        """The same problem with diffuse lobes of the roughness of ``gloss``.

        Args:
            moments: of the light at the seen patches, once it is about known.
        """
        transport = self.light.transport
        kappa = grazing_gain(self.diffuse.lobe, gloss.roughness)[transport.region]
        light = replace(self.light, transport=transport.with_lobes(kappa, moments))
        return replace(self, light=light, diffuse=self.diffuse.under(gloss.layered))

    def materials_under(
        self, lights: Lights, scanned: NDArray[np.bool_], pieces: NDArray[np.int32]
    ) -> NDArray[np.int32]:
        """(n_regions,) label of each region, the same for regions that are one material under ``lights``.

        Args:
            scanned: (F,) bool, faces of scans; other regions keep their label.
            pieces: (F,) smooth piece of the surface of each face.
        """
        light, seen = self.light, self.observed
        if not scanned.any():
            return light.material
        n, n_faces = len(seen.radiance), len(light.regions)
        # Few views show a highlight: the radiance that nearly all of them reach is that of the paint.
        least = np.minimum(seen.radiance, light.brightness.floor[:n])  # the first cells are the patches
        albedo = np.maximum(least, 1e-6) / np.maximum(lights.irradiance[:n], 1e-6)
        patch, face = light.surface.sample_patch, light.samples.face
        known = seen.known.all(1)[patch]
        log_albedo = group_means(np.log(albedo)[patch[known]], face[known], n_faces)
        pixels = np.bincount(face[known], minlength=n_faces)
        return joined_regions(light.regions, light.adjacency, log_albedo, pixels, scanned, pieces)

    def with_materials(self, material: NDArray[np.int32]) -> MaterialProblem:
        """The same problem with patches and observations in regions of one ``material`` (n_regions,) joined."""
        light = self.light
        surface = replace(light.surface, region=material[light.surface.region])
        transport = replace(light.transport, region=material[light.transport.region])
        light = replace(light, material=material, surface=surface, transport=transport)
        return replace(self, light=light, region=material[self.region])

    def scene(self, lights: Lights) -> Scene:
        """The scene that reflected rays meet under ``lights``."""
        light = self.light
        seen = light.transport.n_seen
        return Scene(
            tracer=light.tracer,
            transport=light.transport,
            regions=light.regions,
            sample_patch=light.surface.sample_patch,
            patch_radiance=lights.patch_radiance,
            face_emission=lights.face_emission(len(light.regions)),
            unknown=mean_radiance(lights.patch_radiance, light),
            backdrop=light.hidden.completed(self.backdrop, lights.hidden_radiance),
            aim=LampAim.at(light.tracer, lights.emitters, lights.radiance, lights.form_factors[:seen, :, 0]),
            lamp_share=lights.lamp_share,
            profiled=lights.profiled,
        )

    def with_outside(self, outside: OutsideKind, sun: Sun | None) -> MaterialProblem:
        """The same problem with that kind of light from outside, and a sun."""
        hidden = self.light.hidden.of_kind(outside)
        return replace(self, light=replace(self.light, hidden=replace(hidden, sun=sun)))


class _Round(NamedTuple):
    """One of the rounds: its number, whether it is the last, and whether there is one light state."""

    number: int
    last: bool
    alone: bool


def solve_materials(
    problems: Sequence[MaterialProblem], lights: Sequence[Lights], rounds: int, progress: Progress
) -> tuple[list[Lights], Gloss]:
    """Lamps of each light state, and materials, that explain the observations together.

    Args:
        problems: of each state.
        lights: lamps of each found by diffuse shading, the start.
        rounds: times that lamps and gloss are solved for in turn.
    """
    alone = len(problems) == 1
    fits = [_GlossFit.prepare(problem, own) for problem, own in zip(problems, lights, strict=True)]
    shadings = [problem.shading(own) for problem, own in zip(problems, lights, strict=True)]
    gloss, lights = _fitted_gloss(fits, problems, lights, shadings), list(lights)
    for number in range(rounds):
        turn = _Round(number, number == rounds - 1, alone)
        problems = [
            problem.with_gloss(gloss, shading.moments) for problem, shading in zip(problems, shadings, strict=True)
        ]
        found = [
            _lights_under(problem, own, replace(shading, layered=gloss.layered), gloss, turn, progress)
            for problem, own, shading in zip(problems, lights, shadings, strict=True)
        ]
        lights = [found[0].before] if alone else solve_states(found, progress)
        shadings = [problem.shading(own) for problem, own in zip(problems, lights, strict=True)]
        gloss = _fitted_gloss(fits, problems, lights, shadings)
        progress.update((number + 1) / rounds)
    return lights, gloss


def _lights_under(
    problem: MaterialProblem, lights: Lights, shading: Shading, gloss: Gloss, turn: _Round, progress: Progress
) -> LitState:
    """The lamps of one light state, tested and solved for again under ``gloss``, and what they are solved from."""
    specular = _observed_specular(problem, lights, shading, gloss, turn.number, progress)
    o, n_patches = problem.observations, len(problem.observed.weight)
    view_factor = problem.view_factor(shading, gloss.roughness[problem.region])
    diffuse = group_radiance(problem.linear, o.patch, o.count, n_patches, specular, view_factor)
    seen = problem.light.cells.brightness(o, problem.linear, specular)
    bounce = _continued_paths(problem, gloss, turn.number)
    aimed = problem.light.rays_to_bright(lights, stream(problem.seed, "materials.aimed_rays", turn.number))
    light_problem = replace(problem.light, brightness=seen, bounce=bounce, aimed=aimed)
    weight = _balance_weight(problem, gloss, diffuse)
    cast = _cast_radiance(problem, gloss, diffuse, view_factor)
    profiled = lights.profiles is not None  # of a lamp whose faces change the profile is lost
    lights = reconsider_lamps(light_problem, cast, lights, weight, diffuse.radiance, progress)
    shown = Shown(o, problem.linear, specular)
    of_patches = PatchFit(weight, diffuse.radiance)
    if profiled:  # what gloss changes is little beside what a profile has to earn
        lights = with_profiles(light_problem, cast, lights, shown, of_patches, progress)
    if turn.last:
        lights = with_screens(light_problem, cast, lights, shown, weight, diffuse.radiance, progress)
        if turn.alone:  # a pattern is common to all states, and its mean to none
            lights = with_patterns(light_problem, cast, lights, shown, of_patches, progress)
    return LitState(problem=light_problem, observed=cast, emitters=lights.emitters, before=lights, fit=of_patches)


def _glossy_regions(gloss: Gloss) -> NDArray[np.bool_]:
    """(n_regions,) regions from which light paths go on."""
    return gloss.roughness <= BOUNCE_MAX_ROUGHNESS


def _cast_radiance(
    problem: MaterialProblem, gloss: Gloss, diffuse: GroupRadiance, view_factor: NDArray[np.floating]
) -> GroupRadiance:
    """Radiance that patches cast on others: as seen where matte, the diffuse part alone where light paths go on."""
    region = problem.light.transport.region[: len(diffuse.weight)]
    metal = (gloss.metallic[region] > 0.5)[:, None]
    own = np.where(metal, 0.0, diffuse.radiance)
    passes = _glossy_regions(gloss)[region][:, None] & (diffuse.known | metal)
    o = problem.observations
    matte = raised_by_clipped(problem.observed, problem.linear, o.patch, o.count, view_factor)
    return replace(problem.observed, radiance=np.where(passes, own, matte))


def _continued_paths(problem: MaterialProblem, gloss: Gloss, round_: int) -> GlossyBounce:
    """Light paths continued on glossy regions, under the materials of this round."""
    rng = stream(problem.seed, "materials.glossy_bounce", round_)
    light = problem.light
    passes = _glossy_regions(gloss)
    return trace_glossy_bounce(
        light.tracer, light.transport, light.field, light.regions, gloss.roughness, gloss.specular, passes, rng
    )


def _balance_weight(problem: MaterialProblem, gloss: Gloss, diffuse: GroupRadiance) -> NDArray[np.float64]:
    """(P,) weight of each seen patch in the light balance once materials are known, from equation (19)."""
    region = problem.light.transport.region[: len(diffuse.weight)]
    matte = np.where(gloss.roughness[region] < BALANCE_GLOSSY_ROUGHNESS, BALANCE_GLOSSY_WEIGHT, 1.0) * (
        gloss.metallic[region] < 0.5
    )
    # Where nearly all light was specular, the remainder is the error of the lobe.
    mostly_diffuse = diffuse.radiance.min(1) > 0.1 * problem.observed.radiance.min(1)
    return patch_weight(problem.light, diffuse) * matte * mostly_diffuse


def _observed_specular(
    problem: MaterialProblem, lights: Lights, shading: Shading, gloss: Gloss, round_: int, progress: Progress
) -> NDArray[np.float32]:
    """(M, 3) specular radiance of every observation."""
    rng = stream(problem.seed, "materials.specular_lobes", round_)
    ls0, ls1 = specular_lobes(
        problem.scene(lights),
        problem.light.samples,
        problem.observations.sample,
        gloss.roughness[problem.region],
        shading.irradiance[problem.observations.patch],
        problem.specular_rays,
        rng,
        progress,
    )
    return subtract_specular(ls0, ls1, gloss.metallic[problem.region])


@dataclass(frozen=True)
class _GlossFit:
    """The observations that gloss is fitted to, with their reflected rays.

    Attributes:
        rows: (m,) indices of the observations.
        rays: per traced level of GLOSS_LEVELS, two independent halves.
    """

    rows: NDArray[np.int64]
    rays: list[list[LobeRays]]

    @staticmethod
    def prepare(problem: MaterialProblem, lights: Lights) -> _GlossFit:
        """Choose observations off the lamps and trace their rays, once for all rounds."""
        o, light = problem.observations, problem.light
        rng = stream(problem.seed, "materials.gloss")
        usable = problem.linear.unclipped.all(1) & ~lights.mask[light.samples.face[o.sample]]
        rows = choose_observations(problem.region, o.patch, np.where(usable, o.count, 0), rng)
        scene, at = problem.scene(lights), o.sample[rows]
        rays = [
            [trace_lobes(scene, light.samples, at, np.full(len(at), level), n_rays // 2, rng) for _ in range(2)]
            for level, n_rays in zip(GLOSS_LEVELS, GLOSS_RAYS, strict=False)
        ]
        return _GlossFit(rows, rays)

    def observed(self, problem: MaterialProblem, lights: Lights, shading: Shading) -> GlossObservations:
        """The observations with the light that falls on them under ``lights``."""
        o, samples = problem.observations, problem.light.samples
        scene = problem.scene(lights)
        at = o.sample[self.rows]
        local = problem.light.field.at_samples(samples.take(at), o.patch[self.rows], shading.smooth)
        local += shading.sunlight[o.patch[self.rows]]
        lobes = [[scene.lobes(half) for half in halves] for halves in self.rays]
        # The widest lobes are computed from irradiance.
        rough = GLOSS_LEVELS[len(GLOSS_RAYS) :]
        lobes += [[rough_lobes(np.full(len(at), level), samples.cosine[at], local)] for level in rough]
        lobe, levels = problem.diffuse.lobe, np.array(GLOSS_LEVELS)[:, None]
        return GlossObservations(
            region=problem.region[self.rows],
            patch=o.patch[self.rows],
            weight=np.minimum(o.count[self.rows], 20.0),
            position=samples.position[at],
            radiance=problem.mirrored[self.rows],
            irradiance=local,
            diffuse=problem.view_factor(shading, levels, self.rows)
            if lobe == "burley"
            else np.ones((len(levels), len(at))),
            lobes=lobes,
            layer=None if lobe == "burley" else layered_factor(levels, samples.cosine[at]),
            in_file=problem.in_file,
            scanned=problem.scanned,
            known=_known_normals(problem, o.patch[self.rows], problem.region[self.rows]),
        )


def _known_normals(
    problem: MaterialProblem, patch: NDArray[np.integer], region: NDArray[np.integer]
) -> NDArray[np.float64] | None:
    """(m,) from 0 to 1, how well the normals of observations are known. On a scan they are in its planes, to 0.2°;
    where they turn they are off by 4° and more. None without a scan."""
    if problem.scanned is None:
        return None
    spread = problem.light.surface.spread[patch]
    return np.where(problem.scanned[region], 1 / (1 + (spread / SCAN_KNOWN_SPREAD) ** 2), 1.0)


def _fitted_gloss(
    fits: Sequence[_GlossFit],
    problems: Sequence[MaterialProblem],
    lights: Sequence[Lights],
    shadings: Sequence[Shading],
) -> Gloss:
    """Roughness and metallic per region under the ``lights`` of all light states."""
    each = [
        fit.observed(problem, own, shading)
        for fit, problem, own, shading in zip(fits, problems, lights, shadings, strict=True)
    ]
    light = problems[0].light
    observed = GlossObservations.joined(each, light.transport.n_seen)
    return fit_gloss(observed, len(light.material), light.decisions).of_regions(light.material)
