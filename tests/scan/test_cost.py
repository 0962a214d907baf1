"""Absent parts of a scene cost nothing: traced operations are counted, which do not depend on the machine."""

import subprocess
import sys

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxwhisker as jw
from engine import dimensionless
from jaxwhisker._base.checks import as_float
from jaxwhisker._base.program import compilations
from jaxwhisker._equilibrium.contact_state import ContactState
from jaxwhisker._equilibrium.dimensionless import problem_of
from jaxwhisker._equilibrium.friction import slipping_from
from jaxwhisker._equilibrium.newton import newton_step
from jaxwhisker._equilibrium.point import Point, at_control
from jaxwhisker._model.canonical import canonical
from jaxwhisker._scan.blocks import BLOCK
from jaxwhisker._scan.detect import detect, kinds_of
from jaxwhisker._scan.plane import InThePlane, canonical_problem_now, follow_path_now, problem_now
from jaxwhisker._scan.route import across
from jaxwhisker._scan.scan import mechanics_of
from jaxwhisker._scan.slopes import event_slopes_now, events_now, solved_states_now, state_slopes_now
from operations import operations, rods, traced
from scenes import model

pytestmark = pytest.mark.unchecked  # checks of types add operations: properties of protocols are computed for them
CONTROL = np.linspace(0.8, -1.6, 64)


def newton_operations(scene):
    """Number of operations of one Newton step, including its network."""
    dimensionless = problem_of(scene)
    n = scene.support.whiskers
    z = jnp.ones((n, 3))
    friction = None if scene.friction is None else slipping_from(jnp.ones(n))
    state = ContactState(jnp.full(n, 2), jnp.ones(n), friction=friction)
    point = Point(z, jnp.asarray(0.0))
    return operations(traced(lambda p, z: newton_step(p, state, at_control(z.u, z.z), z), dimensionless, point))


def test_a_clamped_whisker_costs_as_much_as_one_on_a_spring_and_a_second_whisker_more():
    # Clamped bases have zero flexibility, and the same program.
    clamped, fb, fbfb = (newton_operations(model(name)) for name in ("clamped", "FB", "FBFB"))
    assert clamped == fb < fbfb
    assert not np.any(problem_of(model("clamped")).flexibility.matrix)


def test_friction_adds_operations_only_to_scenes_that_have_it():
    smooth = model("FB")
    rough = jw.Scene(smooth.whisker, smooth.profile, smooth.support, friction=0.3)
    assert problem_of(smooth).friction_angle is None
    assert newton_operations(smooth) < newton_operations(rough)
    path = jax.eval_shape(follow_path_now.function, problem_of(smooth), *map(jnp.asarray, across())).path
    assert path.nodes.state.friction is None and path.nodes.stop is None


def test_a_further_spring_adds_no_operations():
    # FBFBR has one spring more than FBFB, which changes numbers in the flexibility matrix, but not the step.
    assert newton_operations(model("FBFB")) == newton_operations(model("FBFBR"))


def test_a_further_whisker_adds_few_operations():
    # Whiskers are lanes of one rod. Only the small system that couples them grows with their number.
    two, three = newton_operations(model("FBFB")), newton_operations(model("FBFBFBR"))
    assert three - two < 0.2 * two


def signals(scene):
    result = jw.scan(scene, CONTROL)
    return result.fx, result.fy, result.mz


def signals_and_events(scene):
    result = jw.scan(scene, CONTROL)
    return result.fx, result.fy, result.mz, result.events.before.mz


def slope(scene):
    return jax.grad(lambda scene: jnp.sum(jw.scan(scene, CONTROL).mz))(scene)


def of_scan(function, name="FB"):
    """The traced computation of a scan of a named model."""
    return traced(function, jax.tree.map(jnp.asarray, model(name)))


@pytest.mark.parametrize(("name", "most"), [("clamped", 6700), ("FB", 6750), ("FBFB", 7050)])
def test_a_scan_has_a_limited_number_of_operations(name, most):
    # Half of the operations of an FB scan are decisions of the march. A change that adds many needs a reason.
    # jax 0.12 traces a scan to a tenth fewer operations than jax 0.10.
    assert 0.8 * most < operations(of_scan(signals, name)) < most


def test_a_scan_integrates_rods_in_three_places():
    # In the Newton step of the march, in that of the steps, and for the signals: only values and Newton's own tangents.
    assert rods(of_scan(signals)) == 3


def test_states_at_events_are_computed_only_if_used():
    # The corners of the path are always located, because the path needs them. The states there are optional.
    without, located = of_scan(signals), of_scan(signals_and_events)
    assert rods(located) > rods(without)
    assert operations(located) > operations(without) + 500


def test_derivatives_are_computed_only_if_used():
    assert rods(of_scan(slope)) > rods(of_scan(signals)) + 3


ALLOWED = {"jax", "jaxlib", "equinox", "diffrax", "optimistix", "lineax", "numpy", "jaxtyping"}


def test_import_loads_only_the_numerical_packages():
    # Only these packages and their dependencies. matplotlib, xarray and tqdm are imported on first use.
    code = (
        "import sys\n"
        f"for name in {sorted(ALLOWED)}: __import__(name)\n"
        "before = set(sys.modules)\n"
        "import jaxwhisker\n"
        "import jax\n"
        "assert not jax.config.jax_enable_x64\n"
        "heavy = {name.split('.')[0] for name in set(sys.modules) - before} - set(sys.stdlib_module_names)\n"
        "heavy |= {'matplotlib', 'xarray', 'tqdm', 'pandas', 'scipy.integrate'} & set(sys.modules)\n"
        "print(*sorted(heavy - {'jaxwhisker', 'jax'}))\n"
    )
    run = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)
    assert run.stdout.split() == []


def test_import_loads_what_scans_need():
    # What is done with many scans, and with scenes in space, is loaded on first use.
    code = "import sys, jaxwhisker; print(*{name.split('.')[1] for name in sys.modules if 'jaxwhisker.' in name})"
    run = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)
    assert set(run.stdout.split()) == {"_base", "_rod", "_model", "_equilibrium", "_path", "_plane", "_scan"}


def test_programs_are_compiled_once_and_when_they_are_first_needed():
    # The march and the steps are compiled side by side, before the path between them is known. If the assumed type
    # differed from that of the march's path, even by a weak integer, they would be compiled again without notice.
    scene = jax.tree.map(jnp.asarray, jw.Scene(jw.Whisker(), jw.Parabola(0.2), rod=jw.Shooting(steps=3)))

    def compiled(function) -> int:
        before = compilations()
        jax.block_until_ready(function(scene))
        return compilations() - before

    def mz(scene):
        return jw.scan(scene, CONTROL).mz

    def moved(scene, distance):
        return eqx.tree_at(lambda scene: scene.profile.distance, scene, distance)

    def event(scene):
        return jw.scan(scene, CONTROL).events.control[0]

    assert compiled(mz) == 3  # problem, path, states
    assert compiled(event) == 1
    assert compiled(jax.jacfwd(mz)) == 4  # spring lengths, and slopes of these, the problem and the states
    assert compiled(jax.grad(event)) == 1
    assert compiled(lambda scene: jax.vmap(lambda u: mz(moved(scene, u)))(jnp.array([0.2, 0.3]))) == 0
    for again in (mz, event, jax.jacrev(mz), jax.jacfwd(event)):
        assert compiled(again) == 0


# Operations of the paths of one whisker with jax 0.10, of which jax 0.12 traces up to a fifth fewer.
BEFORE, SPHERE = jw.Parabola(0.2), jw.Sphere(1.0, (0.0, 1.3, -0.2))
PATHS = {
    "plane": (jw.Scene(jw.Whisker(), BEFORE, jw.Support.fb(70.0)), 4078),
    "plane, friction": (jw.Scene(jw.Whisker(), BEFORE, jw.Support.fb(70.0), friction=0.3), 7726),
    "space": (jw.Scene(jw.Whisker(), SPHERE), 6013),
    "space, friction": (jw.Scene(jw.Whisker(), SPHERE, friction=0.3), 8407),
}
SEARCH = 3600  # operations of the search for second contacts
PATH_GROWTH = 1.03  # a change that adds more needs a reason: users wait for the path first


@pytest.mark.parametrize("name", PATHS)
def test_a_path_has_a_limited_number_of_operations(name):
    scene, most = PATHS[name]
    mechanics = mechanics_of(scene)
    whole = traced(lambda problem: mechanics.follow(problem, *map(jnp.asarray, across())), dimensionless(scene))
    assert 0.8 * most < operations(whole) < PATH_GROWTH * most


def test_the_search_for_second_contacts_has_a_limited_number_of_operations():
    """Objects of one kind, here circles, are searched by the same operations, however many there are."""
    for objects in (1, 3):
        circles = tuple(jw.Circle(0.5, 0.2, position=0.7 * k) for k in range(objects))
        scene = jw.Scene(jw.Whisker(intrinsic_curvature=0.2), circles)
        problem, kinds = dimensionless(scene), kinds_of(scene)
        path = jax.eval_shape(lambda problem: InThePlane.follow(problem, *map(jnp.asarray, across())).path, problem)
        whole = traced(lambda problem, path, kinds=kinds: detect(problem, path, kinds), problem, path)
        assert 0.8 * SEARCH < operations(whole) < 1.1 * SEARCH


# For FB: operations of StableHLO with jax 0.10 (jax 0.12 has fewer), and fusions of XLA with jax 0.10 and 0.12, which
# fuse differently. More of them take longer to compile. The curve of all conic sections adds 4 to 17 % of fusions to
# programs other than the path. Those with jax 0.12 were not measured again, but grow in the same ratio.
SIZES = {
    "problem_of": (371, 30, 33),  # for all conic sections, and networks of one whisker
    "follow_path": (4828, 266, 381),
    "solved_states": (2662, 177, 230),
    "events": (1322, 92, 123),
    "state_slopes": (2971, 193, 282),
    "event_slopes": (7885, 652, 902),
}
GROWTH = 1.1  # a change that adds more needs a reason


def test_programs_of_a_scan_have_a_limited_size():
    scene = jax.tree.map(as_float, jw.Scene(jw.Whisker(), jw.Parabola(0.2), jw.Support.fb(70.0)))
    problem = problem_now(scene)
    step = np.zeros(BLOCK)
    path = follow_path_now(problem, *map(np.asarray, across())).path
    *_, solutions = solved_states_now(InThePlane, problem, path, step, step, None)
    calls = {
        canonical_problem_now: (canonical(scene),),
        follow_path_now: (problem, *map(np.asarray, across())),
        solved_states_now: (InThePlane, problem, path, step, step, None),
        events_now: (InThePlane, problem, path, None),
        state_slopes_now: (InThePlane, problem, step, solutions, None),
        event_slopes_now: (InThePlane, problem, path, None),
    }
    for program, args in calls.items():
        static = (0,) if args[0] is InThePlane else ()
        lowered = jax.jit(program.function, static_argnums=static).lower(*args)
        fusions = program.executable(*args).as_text().count(" fusion(")
        most_operations, *most_fusions = SIZES[program.function.__name__]
        assert lowered.as_text().count("stablehlo.") < GROWTH * most_operations, program.function.__name__
        most = most_fusions[jax.__version_info__ >= (0, 11)]
        assert fusions < GROWTH * most, program.function.__name__


def test_the_loop_of_the_march_ends_on_more_than_one_value():
    # A loop that ends on one value looks like a counter to XLA, which then takes 40 % longer to compile it.
    scene = jax.tree.map(as_float, model("FB"))
    whole = traced(lambda scene: follow_path_now.function(problem_of(scene), *map(jnp.asarray, across())), scene)
    loops = [equation.params["cond_jaxpr"].jaxpr for equation in whole.eqns if equation.primitive.name == "while"]
    assert loops
    for condition in loops:
        used = {id(v) for equation in condition.eqns for v in equation.invars} & {id(v) for v in condition.invars}
        assert len(used) > 1


def test_a_scan_in_the_plane_loads_nothing_of_space():
    code = (
        "import sys, jax; jax.config.update('jax_enable_x64', True); import jaxwhisker as jw; "
        "jw.scan(jw.Scene(jw.Whisker(), jw.Parabola(0.2)), [0.5, 0.4]); "
        "of_space = ('space', 'surface', 'quadrics', 'solids', 'drives', 'rotation'); "
        "ours = [name for name in sys.modules if name.startswith('jaxwhisker')]; "
        "print([name for name in ours if any(part in name for part in of_space)])"
    )
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=300)
    assert found.stdout.strip() == "[]"


def test_a_scene_in_the_plane_has_no_leaf_of_space():
    """Whisker, support and mounts have fields for space; without them, a scene has the numbers that it had before."""
    support = jw.Support.fb(70.0)
    assert len(jax.tree.leaves(jw.Whisker())) == 2  # length and bending stiffness
    assert len(jax.tree.leaves(jw.Mount())) == 3
    assert len(jax.tree.leaves(jw.Scene(jw.Whisker(), jw.Parabola(0.2), support))) == 2 + 3 + 2
