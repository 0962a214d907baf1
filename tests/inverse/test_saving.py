"""Results can be saved, sent to other processes and copied: pickle, cloudpickle, copy and equinox."""

import copy
import dataclasses
import enum
import inspect
import pickle

import cloudpickle
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxwhisker as jw
from jaxwhisker._inverse.fit_contour import ContourFit, _ConstantSensor, _ContourScene
from recordings import STEPS, TRUTH, exact, fb

BENT = {"force": [0.1, 0.2], "tip_x": [-0.03, -0.06]}
COPIES = {
    "pickle": lambda value: pickle.loads(pickle.dumps(value)),
    "cloudpickle": lambda value: pickle.loads(cloudpickle.dumps(value)),
    "copy": copy.copy,
    "deepcopy": copy.deepcopy,
}


@pytest.fixture(scope="module")
def results():
    """One result of every class; all of them come from the same few programs."""
    scene, control = fb(**TRUTH), np.linspace(0.75, -1.35, STEPS)
    result, fit = jw.scan(scene, control), jw.identify(fb, TRUTH, exact(scene), near=True)
    points, drive = jw.reconstruct(result, scene), jw.Whisking(0.1, 0.05, offset=0.9)
    knots = -0.5, 0.0, 0.5
    contour = ContourFit(jw.Contour.like(jw.Parabola(0.2), knots), fit, jw.Sensor.of(scene))
    made = [result, result.events, jw.shapes(result), jw.energy_balance(result), points, fit, contour]
    made += [jw.fit_profile(points, jw.Parabola), jw.information(fb, TRUTH, control=control, sigma=0.1)]
    heavy = jw.Whisker(mass_per_length=1.0)
    made += [jw.deflect(jw.Whisker(), jw.PointForce(1.0)), jw.modes(heavy, 2), jw.lateral_stability(result)]
    made += [jw.simulate(jw.Scene(heavy, jw.Parabola(0.2)), drive, 0.1, steps=4)]
    made += [jw.identify(lambda force, c: (jw.Whisker(bending_stiffness=c), jw.PointForce(force)), {"c": 1.0}, BENT)]
    in_space = jw.SpaceScene(jw.Whisker(), jw.Sphere(1.0, (0.0, 1.3, 0.2)))
    made += [scanned := jw.scan(in_space, np.linspace(0.75, -1.35, STEPS)), jw.reconstruct(scanned, in_space)]
    made += [jw.fit_contour(made[-1], family=jw.Sphere), jw.shapes(scanned), jw.bending(scanned, [0.1])]
    model = jw.MeasurementModel(lambda x: jw.SpaceScene(jw.Whisker(), jw.Sphere(1.0, (x, 1.3, 0.2))), ("x",))
    made += [model([0.0], 0.4, model.contact([0.0], np.array([0.75, 0.4])))]
    made += [jw.deflect(jw.Whisker(), jw.SpaceForce(0.3, 0.0, 0.2))]
    loaded = {"control": [0.0], "fx": [0.1], "fy": [0.2], "mz": [0.1]}
    circles = jw.Circle(0.5, 0.2), jw.Circle(0.25, 0.12, position=-0.55)
    made += [jw.reconstruct(loaded, jw.Sensor(jw.Whisker()), contacts=2, objects=circles)]
    made += [jw.study(fb, control=control, c=[50.0, 60.0], q=[0.27]), result.events[0], fit.profile("c", points=3)]
    return {type(one).__name__: one for one in made}


TREES = {"Result", "Events", "Shapes", "EnergyBalance", "Reconstruction", "ProfileFit", "Deflection", "Modes"}
TREES |= {"Simulation", "LateralStability", "SpaceResult", "SpaceDeflection", "SpaceReconstruction", "SurfaceFit"}
TREES |= {"Measurement", "SpaceShapes", "ContactsReconstruction", "Bending"}
CLASSES = TREES | {"Fit", "BendingFit", "ContourFit", "Information", "Dataset", "Event", "LikelihoodProfile"}


def test_every_public_class_of_results_is_here(results):
    inputs = {"Whisking", "Sweep", "Scene", "Sensor", "Support", "Spring", "Mount", "Foundation", "Splitting", "State"}
    inputs |= {"SpaceState", "MeasurementModel", "Array"}
    inputs |= {name for name in jw.__all__ if inspect.isclass(getattr(jw, name)) and is_input(getattr(jw, name))}
    public = {name for name in jw.__all__ if inspect.isclass(getattr(jw, name))} - inputs
    assert public <= CLASSES == set(results)


def is_input(kind):
    return issubclass(kind, enum.Enum) or kind.__module__.startswith(("jaxwhisker._model", "jaxwhisker._rod"))


@pytest.mark.parametrize("name", sorted(CLASSES))
@pytest.mark.parametrize("how", COPIES)
def test_results_can_be_copied(name, how, results):
    value = results[name]
    copied = COPIES[how](value)
    assert type(copied) is type(value) and str(copied) == str(value)
    assert_same(copied, value)


@pytest.mark.parametrize("name", sorted(TREES))
def test_trees_of_arrays_can_be_serialised(name, results, tmp_path):
    value = results[name]
    eqx.tree_serialise_leaves(tmp_path / "result.eqx", value)
    empty = jax.tree.map(lambda leaf: jnp.zeros_like(leaf) if eqx.is_array(leaf) else leaf, value)
    assert_same(eqx.tree_deserialise_leaves(tmp_path / "result.eqx", empty), value)


def test_copied_fits_still_compute(results):
    fit = pickle.loads(pickle.dumps(results["Fit"]))
    profile = fit.profile("c", points=3)
    np.testing.assert_array_equal(profile.misfit, results["LikelihoodProfile"].misfit)


def test_scenes_of_contour_fits_can_be_pickled():
    sensor = jax.tree.map(float, jw.Sensor(jw.Whisker(), jw.Support.fb(70.0)))
    build = _ContourScene(_ConstantSensor(sensor), (), (), (-0.5, 0.5))
    assert pickle.loads(pickle.dumps(build)) == build


def assert_same(one, other):
    """Check that all numbers of two results are equal."""
    pairs = [jax.tree.leaves(vars(value) if dataclasses.is_dataclass(value) else value) for value in (one, other)]
    for a, b in zip(*pairs, strict=True):
        if eqx.is_array_like(a):
            np.testing.assert_array_equal(a, b)
