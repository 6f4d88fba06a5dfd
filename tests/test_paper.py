"""The paper's claims, measured: where they hold, and where they do not. docs/paper.md states the numbers."""

from __future__ import annotations

import itertools
import re
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from scipy import ndimage, optimize, signal

from clvol import Volume, analysis, filters, phantoms, read, reference
from clvol.analysis.angle import mean_angle
from clvol.device import Device
from clvol.figures import FIGURE_6, edges, figure6, noise, panels, pipeline, slices
from clvol.figures.errors import mean_square, measure
from clvol.filter.table import as_filter

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "docs" / "paper.md"
TOOTH = ROOT.parent / "shared" / "data" / "tooth.nhdr"
CRESTS, TROUGHS = (0.3730, 0.5355, 0.6665), (0.4600, 0.6035)  # radii at which the Marschner-Lobb function is extreme


@pytest.fixture(scope="module")
def errors() -> dict[tuple[str, int], dict[str, float]]:
    """Mean square errors by input and dimensions, as Figure 4 draws them."""
    return {(case.name, case.dimensions): case.errors for case in measure()}


@pytest.fixture(scope="module")
def page() -> str:
    """The page of claims."""
    if not PAGE.is_file():
        pytest.skip("not in a checkout")
    return PAGE.read_text(encoding="utf-8")


def rings(name: str, radii: tuple[float, ...]) -> np.ndarray:
    """Heights along a quarter of each ring of the Marschner-Lobb function, 41³ samples; (rings, places)."""
    angle = np.linspace(0, np.pi / 2, 361)
    points = np.stack([np.stack([r * np.cos(angle), r * np.sin(angle), 0 * angle], -1) for r in radii])
    return reference.sample(phantoms.marschner_lobb(41), points, name)


def test_interpolation_leaves_the_convex_hull_of_the_samples() -> None:
    samples = np.random.default_rng(0).uniform(0, 1, (24, 24, 24))
    points = np.random.default_rng(1).uniform(0, 23, (100_000, 3))
    coefficients = reference.prefilter(samples, "bspline3")
    assert (coefficients.min(), coefficients.max()) == (pytest.approx(-6.06, abs=0.05), pytest.approx(6.69, abs=0.05))
    values = reference.sample(Volume(samples), points, "bspline3")
    assert (values.min(), values.max()) == (pytest.approx(-0.24, abs=0.01), pytest.approx(1.26, abs=0.01))
    assert coefficients.min() <= values.min() <= values.max() <= coefficients.max()  # the hull that does hold
    values = reference.sample(Volume(samples), points, "bspline3-approx")
    assert samples.min() <= values.min() <= values.max() <= samples.max()


def test_interpolation_is_not_variation_diminishing() -> None:
    step = analysis.step_response("bspline3")
    assert (step.overshoot, step.ringing) == (pytest.approx(0.108, abs=0.001), pytest.approx(0.589, abs=0.001))
    step = analysis.step_response("bspline3-approx")
    assert (step.overshoot, step.ringing) == (0, pytest.approx(0, abs=1e-12))


def test_the_influence_of_a_sample_decays_by_the_pole() -> None:
    halfway = analysis.impulse_response("bspline3", np.arange(1.5, 9))
    np.testing.assert_allclose(halfway[1:] / halfway[:-1], np.sqrt(3) - 2, rtol=1e-6)
    assert abs(analysis.impulse_response("bspline3", 6.5)) < 1e-3


def test_the_hybrid_lies_between_direct_and_the_cubics() -> None:
    names = ["bspline3", "hybrid", "catmull-rom", "mitchell", "linear"]
    table = analysis.compare(
        phantoms.marschner_lobb_function, names, gradient=phantoms.marschner_lobb_gradient, points=20_000, timing=False
    )
    rms = [row.rms for row in table]
    assert rms == sorted(rms)
    assert rms[1] == pytest.approx(0.0178, rel=0.02)


def test_hybrid_gradients_are_as_good_as_direct_central_differences(page: str) -> None:
    volume, points = phantoms.marschner_lobb(41), np.random.default_rng(1999).uniform(-0.8, 0.8, (20_000, 3))
    truth = phantoms.marschner_lobb_gradient(points)
    made = []
    for name, gradient in (("hybrid", "central"), ("bspline3", "analytic"), ("hybrid", "analytic"), ("linear", "central")):
        row = as_filter(name)
        if gradient == "central":  # a voxel of the grid that is drawn by trilinear interpolation, to either side
            steps = np.eye(3) * volume.spacing[0] / row.scale
            ahead, behind = ([reference.sample(volume, points + sign * h, row) for h in steps] for sign in (1, -1))
            slopes = np.stack(ahead, -1) - np.stack(behind, -1)
        else:
            slopes = reference.sample(volume, points, row, derivative=1)
        made.append(mean_angle(slopes, truth) or 0)
    pattern = f"{NUMBER}° from the true ones in the mean, where the derivative of the direct spline is {NUMBER}° off"
    states(page, rf"{pattern}\. .* itself would be {NUMBER}° off, .* interpolation alone, {NUMBER}°", *made)
    assert made[0] < made[1] < made[2] < made[3]


def test_normals_of_figure_3(page: str, device: Device) -> None:
    volume = phantoms.marschner_lobb(41)
    surface, _ = panels.exact(volume, panels.CAMERA, 300, 1)
    truth = phantoms.marschner_lobb_gradient(surface)
    drawn = (("hybrid", "central"), ("bspline3", "analytic"), ("linear", "central"))
    made = [
        mean_angle(panels.shading_gradients(volume, surface, as_filter(n), device, g), truth, faces=True) or 0 for n, g in drawn
    ]
    states(
        page, f"normals of the hybrid are {NUMBER}° off, direct ones {NUMBER}°, those of trilinear interpolation {NUMBER}°", *made
    )


def test_pictures_are_reconstructed_from_rays(page: str, device: Device) -> None:
    pytest.importorskip("matplotlib")
    (numbers,) = pipeline.draw(device=device).numbers
    pattern = f"one ray a pixel differs from 1024 rays by {NUMBER} .*, sixteen by {NUMBER} "
    states(page, pattern, numbers["aliasing"]["1"], numbers["aliasing"]["16"])


def test_an_ideal_low_pass_makes_clouds_and_caves_and_a_gaussian_does_not(page: str, device: Device) -> None:
    made = {
        (lowpass, name): edges.strays(edges.scanned(40, lowpass), as_filter(name), device)
        for lowpass in edges.LOWPASSES
        for name in ("linear", "bspline3-approx", "bspline3")
    }
    ideal, soft = made["ideal", "bspline3"], made["gaussian", "bspline3"]
    pattern = f"rises again by {NUMBER} on the way out of a face, .* falls again by {NUMBER} on the way in"
    states(page, f"{pattern}, .* no more than {NUMBER}", ideal["cloud"], ideal["cave"], max(soft.values()))
    others = made["ideal", "linear"]["cloud"], made["ideal", "bspline3-approx"]["cloud"], made["none", "bspline3"]["cloud"]
    states(page, rf"rises by {NUMBER} after the ideal low-pass, .* hides it \({NUMBER}\)\. .* worse still, {NUMBER} ", *others)


def test_the_spline_has_the_smallest_error_between_slices_that_resolve_the_waves(page: str, device: Device) -> None:
    names = ["linear", "mitchell", "hybrid", "bspline3"]
    made = slices.from_function([as_filter(name) for name in names], 61, (2, 3, 6), device)
    pattern = f"linear interpolation errs by {NUMBER}, Mitchell's by {NUMBER}, the hybrid by {NUMBER}"
    states(page, f"{pattern}, the interpolating B-spline by {NUMBER};", *(made[2][name] for name in names))
    states(page, f"hold the waves, by {NUMBER}, {NUMBER}, {NUMBER} and {NUMBER}", *(made[3][name] for name in names))
    states(page, f"turns over: linear {NUMBER}, the B-spline {NUMBER}", made[6]["linear"], made[6]["bspline3"])


@pytest.mark.skipif(not TOOTH.is_file(), reason="the scan of a tooth is not here")
def test_omitted_slices_of_a_tooth(page: str, device: Device) -> None:
    pytest.importorskip("SimpleITK")
    made = slices.from_scan(read(TOOTH), [as_filter(name) for name in ("mitchell", "linear", "bspline3", "hybrid")], (2, 4), device)
    states(
        page, f"Mitchell's errs by {NUMBER}, linear interpolation by {NUMBER}, the B-spline by {NUMBER}", *[*made[2].values()][:3]
    )
    order = ("bspline3", "mitchell", "linear")
    states(page, f"three of four left out, {NUMBER}, against {NUMBER} and {NUMBER};", *(made[4][name] for name in order))
    assert made[4]["hybrid"] == pytest.approx(made[4]["bspline3"], rel=0.005)


def test_noise_reverses_the_order_of_the_six(page: str, device: Device) -> None:
    sphere, waves = noise.cases()
    names = ["bspline3", "linear", "bspline3-approx", "bspline3(auto)"]
    made = noise.measure(sphere, [as_filter(name) for name in names], (0.1,), device)
    pattern = f"is {NUMBER} of the range by interpolation, {NUMBER} by linear interpolation, {NUMBER} by the approximation"
    states(page, pattern, *(n["rms"] for n in made[:3]))
    smoothed = f"the sphere's error falls to {NUMBER}, and its normals are {NUMBER}° off instead of {NUMBER}°"
    states(page, smoothed, made[3]["rms"], made[3]["angle"], made[0]["angle"])
    hard = noise.measure(waves, [as_filter(names[i]) for i in (3, 0)], (0.03, 0.1), device)
    pattern = f"of the range by {NUMBER} against {NUMBER} by interpolation, at a tenth by {NUMBER} against {NUMBER}"
    states(page, pattern, *(n["rms"] for n in hard))
    single = noise.measure(waves, [as_filter(f"bspline3({value})") for value in (0.01, 0.1)], (0.1,), device)
    states(page, f"0.01 and 0.1 err by more than {NUMBER} at a tenth", 0.05)
    assert all(n["rms"] > 0.05 for n in single)
    easy = noise.measure(sphere, [as_filter(name) for name in ("bspline3(1)", "bspline3(auto)")], (0.003,), device)
    states(page, f"noise of three thousandths, {NUMBER} against {NUMBER}", *(n["rms"] for n in easy))


def test_the_page_states_the_noise_that_filters_keep(page: str) -> None:
    lines = re.findall(rf"^\| (nearest|`[^`]+`) \| {NUMBER} \| {NUMBER} \|$", page, re.MULTILINE)
    assert len(lines) == 10
    for name, along, within in lines:
        gain = analysis.variance_gain(name.strip("`"))
        assert (float(along), float(within)) == (pytest.approx(gain, abs=5.1e-4), pytest.approx(gain**3, abs=5.1e-4))
    assert [float(within) for _, _, within in lines] == sorted((float(within) for _, _, within in lines), reverse=True)


@pytest.mark.thorough
def test_whether_the_sinc_has_the_smallest_error_depends_on_the_data(errors: dict[tuple[str, int], dict[str, float]]) -> None:
    least = {case: min(made, key=lambda name: made[name]) for case, made in errors.items()}
    assert least[("Marschner–Lobb", 3)] == least[("Marschner–Lobb, z = 0", 2)] == analysis.EXACT_SINC
    assert least[("zone plate", 3)] == least[("zone plate", 2)] == "bspline3"


@pytest.mark.one_in(6)
@pytest.mark.parametrize("size", [48, 49, 50, 51, 53])
def test_at_hard_edges_linear_has_the_smallest_error_and_the_sinc_more_than_the_spline(size: int) -> None:
    """For any size: averaged over the position of edges among the kept samples."""
    hard = mean_square([analysis.compare(phantoms.box(size), FIGURE_6, lowpass="none", points=1000, timing=False)])
    assert list(hard) == list(FIGURE_6)
    assert min(hard, key=lambda name: hard[name]) == "linear"
    assert max(hard, key=lambda name: hard[name]) == "nearest"
    assert hard["mitchell"] < hard["bspline3"] < 0.95 * hard[analysis.EXACT_SINC]


@pytest.mark.thorough
def test_the_table_of_errors_on_the_page_is_measured(page: str, errors: dict[tuple[str, int], dict[str, float]]) -> None:
    head, _, *lines = re.findall(r"^\|.*\|$", page[page.index("| input |") :], re.MULTILINE)[: len(errors) + 2]
    assert len(head.split("|")) - 3 == len(FIGURE_6)
    for line, ((name, dimensions), made) in zip(lines, errors.items(), strict=True):
        label, *cells = (cell.strip() for cell in line.strip("|").split("|"))
        assert label.startswith(name.split(",")[0])
        assert ("²" in label, "³" in label) in ((dimensions == 2, dimensions == 3), (False, False))
        printed = [float(cell.strip("*")) for cell in cells]
        assert printed == [pytest.approx(made[row], rel=0.006) for row in FIGURE_6], label  # three digits
        assert [cell.startswith("**") for cell in cells] == [value == min(printed) for value in printed], label


def states(page: str, pattern: str, *values: float) -> None:
    """Require that the numbers on the page, where `pattern` matches, are these, rounded as written there."""
    found = re.search(pattern, " ".join(page.split()))
    assert found, pattern
    assert len(found.groups()) == len(values)
    for text, value in zip(found.groups(), values, strict=True):
        exponent = int(text.partition("e")[2] or 0)
        decimals = len(text.partition("e")[0].partition(".")[2]) - exponent
        assert abs(float(text) - value) <= 0.501 * 10**-decimals, (pattern, text, value)


NUMBER = r"(\d[\d.]*(?:e-\d+)?(?<!\.))"


def test_the_page_states_the_measured_properties(page: str) -> None:
    samples = np.random.default_rng(0).uniform(0, 1, (24, 24, 24))
    values = reference.sample(Volume(samples), np.random.default_rng(1).uniform(0, 23, (100_000, 3)), "bspline3")
    held = reference.prefilter(samples, "bspline3")
    pattern = f"24³ of them, have control points from −{NUMBER} to {NUMBER} and interpolated values from −{NUMBER} to {NUMBER}"
    states(page, pattern, -held.min(), held.max(), -values.min(), values.max())
    step, mitchell = analysis.step_response("bspline3"), analysis.step_response("mitchell")
    states(page, f"overshoots by {NUMBER} % on either side and varies by {NUMBER} of", 100 * step.overshoot, step.ringing)
    states(page, f"falls by √3 − 2, a factor of {NUMBER}, with", 2 - np.sqrt(3))
    kept = [float(analysis.frequency_response(name, np.pi / 2)) for name in ("mitchell", "bspline3")]
    states(page, f"Mitchell keeps {NUMBER} of a wave, the interpolating B-spline {NUMBER};", *kept)
    states(page, f"rises from 10 to 90 % in {NUMBER} samples with Mitchell's, in {NUMBER} with", mitchell.rise, step.rise)
    states(page, f"ringing, {NUMBER} % of a step against {NUMBER} %", 100 * step.overshoot, 100 * mitchell.overshoot)
    ideal = [100 * analysis.lowpass_step("ideal", np.pi / k).overshoot for k in (32, 64, 128, 256, 512)]
    states(page, f"overshoots a step by {NUMBER} % whatever its cutoff", 100 * analysis.WILBRAHAM_GIBBS)
    assert "within 0.01 % of that from π/512 to π/32" in page
    assert np.abs(np.array(ideal) - 100 * analysis.WILBRAHAM_GIBBS).max() < 0.01


def test_the_page_states_the_measurements_of_the_hybrid(page: str) -> None:
    direct, hybrid, linear = (analysis.bands(name) for name in ("bspline3", "hybrid", "linear"))
    states(page, f"direct errs by at most {NUMBER}, the hybrid by {NUMBER}", direct.passband_error, hybrid.passband_error)

    def responses(omega: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Eqs (18) and (17)."""
        near = np.sinc(omega / (4 * np.pi)) ** 2 * np.cos(omega / 4) ** 4 * (2 + np.cos(omega / 2)) / (2 + np.cos(omega))
        return near, 3 * np.sinc(omega / (2 * np.pi)) ** 4 / (2 + np.cos(omega))

    edge = optimize.brentq(lambda w: float(np.subtract(*responses(w))), 2.1 * np.pi, 2.3 * np.pi)
    states(page, f"less\\* through at every frequency below {NUMBER} π", edge / np.pi)
    states(page, f"hybrid passes {NUMBER} of a wave, direct {NUMBER}", *map(float, responses(np.array(1.5 * np.pi))))
    peaks = [float(np.abs(v).max()) for v in responses(np.linspace(edge, 16 * np.pi, 200_001))]
    decibels = [-20 * np.log10(peak) for peak in peaks]
    pattern = rf"{NUMBER} π it is up to {NUMBER} \(−{NUMBER} dB\) against {NUMBER} \(−{NUMBER} dB\)"
    states(page, pattern, edge / np.pi, peaks[0], decibels[0], peaks[1], decibels[1])
    energy = [float((v**2).sum()) for v in responses(np.linspace(np.pi, 64 * np.pi, 400_001))]
    states(page, f"the hybrid passes {NUMBER} % less energy", 100 * (1 - energy[0] / energy[1]))
    states(page, f"linear errs by {NUMBER} there and lets {NUMBER} through", linear.passband_error, linear.stopband_peak)
    names = ["hybrid", "linear", "mitchell", "catmull-rom", "bspline3"]
    rows = analysis.compare(phantoms.marschner_lobb_function, names, gradient=phantoms.marschner_lobb_gradient, timing=False)
    pattern = f"of the hybrid is {NUMBER}, that of linear interpolation {NUMBER}, Mitchell {NUMBER}, Catmull–Rom {NUMBER}, direct"
    states(page, f"{pattern} {NUMBER} ", *(row.rms for row in rows))


def nearest_of_every_second(data: np.ndarray, first: tuple[int, ...], margin: int = 4) -> float:
    """The mean square error of `nearest` for one choice of the kept samples; half-way it takes the upper one."""
    at, near = [], []
    for n, start in zip(data.shape, first, strict=True):
        kept = np.arange(start, n, 2)
        at.append(np.arange(kept[margin], kept[-1 - margin] + 1))
        near.append(start + 2 * ((at[-1] - start + 1) // 2))
    return float(((data[np.ix_(*near)] - data[np.ix_(*at)]) ** 2).mean())


@pytest.mark.thorough
def test_the_page_states_the_measurements_of_the_six(
    page: str, errors: dict[tuple[str, int], dict[str, float]], device: Device
) -> None:
    hard = errors["box, hard edges", 3]
    states(page, f"{NUMBER} % more than the interpolating B-spline", 100 * (hard[analysis.EXACT_SINC] / hard["bspline3"] - 1))
    single = [nearest_of_every_second(phantoms.box(82).data, first) for first in itertools.product((0, 1), repeat=3)]
    states(page, f"neighbour errs on the box by anything from {NUMBER} to {NUMBER} ", min(single), max(single))
    times = [errors["zone plate", d][analysis.EXACT_SINC] / errors["zone plate", d]["bspline3"] for d in (2, 3)]
    assert "errs seven to nine times as much as the interpolating B-spline" in " ".join(page.split())
    assert [round(t) for t in sorted(times)] == [7, 9]
    names = (analysis.EXACT_SINC, "bspline3", "bspline5", "sinc", "sinc4n", "lanczosn(4)")
    panels, _ = figure6(40, 8, names, rays=1, device=device)
    rms = [p.rms or 0 for p in panels[:6]]
    pattern = rf"RMS {NUMBER} against {NUMBER}\), .* leaves both behind \({NUMBER}\)\. .* the worst of all \({NUMBER}\)"
    states(page, rf"{pattern}, .*`sinc4n`, {NUMBER}, .*`lanczosn\(4\)`, {NUMBER}\)", *rms)
    states(page, f"that 2000 random points found, {NUMBER} ", panels[0].residual or 0)
    high, low = (phantoms.marschner_lobb_function(np.array([[r, 0, 0] for r in radii])).mean() for radii in (CRESTS, TROUGHS))
    left = [rings(name, CRESTS).mean() - rings(name, TROUGHS).mean() for name in ("bspline3-approx", "bspline3")]
    states(page, f"are {NUMBER} high; .* leaves {NUMBER}, less than half, the interpolation {NUMBER}", float(high - low), *left)
    scatter = [rings(name, CRESTS).std(1).mean() for name in ("linear", "mitchell", "bspline3", "nearest")]
    states(page, rf"scatter by {NUMBER} \(.* Mitchell's by {NUMBER}, .* B-spline by {NUMBER} .* worse still, {NUMBER}\.", *scatter)


def test_the_page_states_the_constants_of_cubics(page: str) -> None:
    constants = [analysis.approximation(name).constant for name in ("omoms3", "moms3", "bspline3")]
    states(page, f"its constant is {NUMBER}, that of `moms3`, .* 1/42, {NUMBER}, and that of the B-spline {NUMBER}", *constants)
    rows = analysis.compare(phantoms.marschner_lobb_function, ["omoms3", "moms3"], timing=False)
    states(page, f"`omoms3` errs by {NUMBER}, `moms3` by {NUMBER}", *(row.rms for row in rows))


def test_the_rivals_of_the_hybrid_at_eight_fetches(page: str) -> None:
    """Shifted linear interpolation by SciPy: coefficients by a causal recursion, evaluated a fifth of a sample further on."""
    shift = (1 - 1 / np.sqrt(3)) / 2
    volume, pad = phantoms.marschner_lobb(41), 20
    held = np.pad(volume.data.astype(np.float64), pad, mode="reflect")
    for axis in range(3):
        # (1 - shift) c[k] + shift c[k - 1] = f[k]; what is left of the start is 0.268**20
        held = signal.lfilter([1 / (1 - shift)], [1, shift / (1 - shift)], held, axis)
    points = np.random.default_rng(0).uniform(-0.8, 0.8, (60_000, 3))
    truth = phantoms.marschner_lobb_function(points)
    drawn = ndimage.map_coordinates(held, ((points + 1) * 20 - shift + pad).T[::-1], order=1)
    names = ("linear", "linear-quasi", "hybrid", "bspline3", "bspline3-quasi")
    errors = {name: reference.sample(volume, points, name) - truth for name in names} | {"shifted": drawn - truth}
    rms = {name: float(np.sqrt(np.mean(error**2))) for name, error in errors.items()}
    pattern = (
        rf"linear errs by {NUMBER}, shifted .* by {NUMBER}, quasi-inter.* by {NUMBER}, and the hybrid by {NUMBER}\. The two rivals"
    )
    states(page, pattern, *(rms[name] for name in ("linear", "shifted", "linear-quasi", "hybrid")))
    states(page, f"takes the cubic from {NUMBER} to {NUMBER} ", rms["bspline3"], rms["bspline3-quasi"])

    def response(omega: np.ndarray) -> np.ndarray:
        return np.sinc(omega / (2 * np.pi)) ** 2 * np.exp(-1j * omega * shift) / (1 - shift + shift * np.exp(-1j * omega))

    omega, images = 0.01, 2 * np.pi * np.concatenate([np.arange(-200, 0), np.arange(1, 201)])
    squared = np.abs(1 - response(np.array(omega))) ** 2 + (np.abs(response(omega + images)) ** 2).sum()
    constants = [analysis.approximation(name).constant for name in ("linear-quasi", "linear", "hybrid")]
    states(page, f"least squares, {NUMBER} T² ‖f″‖; linear has {NUMBER}, the hybrid {NUMBER}", *constants)
    assert np.sqrt(squared) / omega**2 == pytest.approx(constants[0], rel=1e-3)


def test_the_sinc_rings_at_the_peak_of_figure_6() -> None:
    """Along a ring about the axis, where the function is constant; 40³ samples, none on the axis."""
    volume, angle = phantoms.marschner_lobb(40), np.linspace(0, 2 * np.pi, 181)
    points = np.stack([0.15 * np.cos(angle), 0.15 * np.sin(angle), 0 * angle], -1)
    scatter = {"bspline3": float(reference.sample(volume, points, "bspline3").std())}
    scatter["sinc"] = float(analysis.dirichlet_sample(volume, points).std())
    assert scatter["sinc"] > 5 * scatter["bspline3"]


def test_the_approximation_flattens_waves() -> None:
    depth = {
        n: float(rings(n, CRESTS).mean() - rings(n, TROUGHS).mean()) for n in ("bspline3-approx", "linear", "mitchell", "bspline3")
    }
    assert list(depth.values()) == sorted(depth.values())
    assert depth["bspline3-approx"] == pytest.approx(0.0911, abs=0.0002)  # of 0.2
    assert depth["bspline3"] == pytest.approx(0.1887, abs=0.0002)


def test_trilinear_crests_are_uneven() -> None:
    scatter = {n: float(rings(n, CRESTS).std(1).mean()) for n in ("bspline3", "mitchell", "linear", "nearest")}
    assert list(scatter.values()) == sorted(scatter.values())
    assert scatter["linear"] == pytest.approx(0.0126, abs=0.0005)
    assert scatter["linear"] > 2 * scatter["bspline3"]


def test_interpolation_is_sharper_than_mitchell_of_the_same_size() -> None:
    mitchell, ours = (filters()[name] for name in ("mitchell", "bspline3"))
    assert mitchell.support == ours.support == 4
    kept = partial(analysis.frequency_response, omega=np.pi / 2)
    assert (kept("mitchell"), kept("bspline3")) == (pytest.approx(0.845, abs=0.001), pytest.approx(0.986, abs=0.001))
    rise = [analysis.step_response(name).rise for name in ("mitchell", "bspline3")]
    assert rise == [pytest.approx(0.85, abs=0.01), pytest.approx(0.74, abs=0.01)]
    assert analysis.step_response("mitchell").overshoot == pytest.approx(0.036, abs=0.001)


def test_the_page_of_claims_names_existing_tests(page: str) -> None:
    sources = {p: p.read_text(encoding="utf-8") for p in (ROOT / "tests").rglob("test_*.py")}
    every = "\n".join(sources.values())
    named = re.findall(r"(tests/[\w/]+\.py)::(test_\w+)", page)
    assert len(named) > 20
    for file, test in named:
        assert f"def {test}(" in sources[ROOT / file], (file, test)
    for test in re.findall(r"`(test_\w+)`", page):
        assert f"def {test}(" in every, test
    pictures = re.findall(r"!\[[^]]+\]\(([^)]+)\)", page)
    assert len(pictures) == 13
    assert all(0 < (ROOT / "docs" / name).stat().st_size < 300_000 for name in pictures)
    rows = re.findall(r"^\| (\d+(?:, \d+)*) \|", page, re.MULTILINE)
    assert [int(n) for row in rows for n in row.split(", ")] == list(range(1, 19))


@pytest.mark.skipif(not TOOTH.is_file(), reason="the scan of a tooth is not here")
def test_most_of_the_error_on_a_tooth_is_the_low_pass() -> None:
    pytest.importorskip("SimpleITK")
    table = analysis.compare(read(TOOTH), ["bspline3"], timing=False, points=100, max_samples=1 << 20)
    page = (ROOT / "docs" / "how-to" / "filters.md").read_text(encoding="utf-8")
    told = re.search(r"\((\d+) % of the squared error of `bspline3` on a CT scan of a tooth\)", page)
    assert told
    assert float(told[1]) == round(100 * (table.lost / (table[0].original or 0)) ** 2)
