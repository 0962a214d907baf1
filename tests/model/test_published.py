"""Published supports: their planar stiffness, as computed from the geometry of pin-jointed springs."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxwhisker as jw

EXACT = 1e-9  # relative


def energy(support, pose):
    """Energy of a support whose rigid follicle has its base displaced by `pose` (x, y, angle)."""
    x, y, turn = pose
    total = 0.0
    for spring in support.springs:
        angle = support.mounts[0].angle + turn
        end = jnp.stack([x - spring.at * jnp.sin(angle), y + spring.at * jnp.cos(angle)])
        rest = spring.at * jnp.stack([-jnp.sin(support.mounts[0].angle), jnp.cos(support.mounts[0].angle)])
        if spring.axis == "axial":
            length = jnp.linalg.norm(end - jnp.stack(spring.anchor)) - spring.rest_length
        else:
            length = (end - rest)[0 if spring.axis == "x" else 1]
        total += spring.stiffness * length**2 / 2
    return total


def stiffness(support):
    return jax.hessian(lambda pose: energy(support, pose))(jnp.zeros(3))


def levels(support, spring_x, at):
    """Stiffness of springs along x at these heights, in the pad's frame."""
    cos = np.cos(support.mounts[0].angle)
    arms = np.stack([np.ones(len(at)), -cos * np.array(at)])
    return (np.array(spring_x) * arms) @ arms.T


def test_simony_has_two_springs_at_each_level_and_one_below():
    support = jw.Support.simony()
    assert support.axes == ("x", "y", "phi")
    across = stiffness(support)[np.ix_([0, 2], [0, 2])]
    expected = levels(support, (0.6, 0.6), (0.0, -4e-3))
    # The spring below the plate turns with the follicle.
    expected[1, 1] += 1.0 * (4e-3 * np.sin(np.radians(25.0))) ** 2
    np.testing.assert_allclose(across, expected, rtol=EXACT)
    np.testing.assert_allclose(stiffness(support)[1, 1], 1.0, rtol=EXACT)
    np.testing.assert_allclose(stiffness(jw.Support.simony(large_angles=True))[1, 1], 0.6, rtol=EXACT)


def test_hill_has_walls_at_both_ends_of_the_pad():
    support = jw.Support.hill()
    along = [spring.stiffness for spring in support.springs if spring.axis == "axial"]
    np.testing.assert_allclose(along[0] + along[1], 0.401, atol=5e-4)  # as computed by the authors' program
    np.testing.assert_allclose(along[2] + along[3], 0.404, atol=6e-3)
    assert support.axes == ("x", "y", "phi")


@pytest.mark.parametrize("make", [jw.Support.berg, jw.Support.schaefer])
def test_two_levels_hold_the_follicle(make):
    support = make(0.5, 0.7, 4e-3)
    assert support.axes == ("x", "phi")
    np.testing.assert_allclose(
        stiffness(support)[np.ix_([0, 2], [0, 2])], levels(support, (0.5, 0.7), (0.0, -4e-3)), rtol=EXACT
    )
    with pytest.raises(ValueError, match="`follicle`"):
        make(0.5, 0.7, -4e-3)


def test_luo_holds_a_beam_inside_the_follicle():
    tissue = jw.Foundation(1e-3, 3e-3, 50.0)
    support = jw.Support.luo(2.0, 1.0, 3.5e-3, 1e-3, tissue=tissue)
    assert [spring.at for spring in support.springs] == [3.5e-3, 1e-3]
    assert support.foundations == (tissue,) and support.axes == ("x", "phi")


@pytest.mark.parametrize("support", [jw.Support.simony(), jw.Support.hill(), jw.Support.berg(0.5, 0.7, 4e-3)])
def test_a_rats_whisker_on_a_published_support_scans_an_object(support):
    whisker = jw.Whisker(0.0331, 6.3e-8)  # C2: length in m, bending stiffness at the base in N m^2
    scene = jw.Scene(whisker, jw.Parabola(0.014, 30.0), support)
    result = jw.scan(scene, np.linspace(0.05, -0.005, 23))
    assert np.all(result.status == jw.Status.ok)
    assert np.max(np.abs(result.mz)) > 0.5 * 6.3e-8 / 0.0331
    assert np.max(np.abs(result.base_angle - result.base_angle[0])) > 0.02  # the follicle turns


def test_hill_connects_neighbouring_follicles():
    support = jw.Support.hill(3)
    assert support.whiskers == 3 and len(support.springs) == 2 * 4 + 3
    spacing = 20e-3 / 4
    assert [mount.x for mount in support.mounts] == pytest.approx([-spacing, 0.0, spacing])
    neighbours = [spring for spring in support.springs if spring.between in ((1, 2), (2, 3))]
    assert [spring.at for spring in neighbours] == [(0.0, 0.0)] * 2 + [(-4e-3, -4e-3)] * 2
    # All follicles move against the walls: the springs between them carry nothing.
    one = jw.Support.hill(1)
    ratio = support.springs[0].stiffness / one.springs[0].stiffness
    assert ratio == pytest.approx(3 * 10e-3 / spacing)  # the mass of three follicles, and a shorter spring
    with pytest.raises(ValueError, match="`pad` must be wider than 4 follicles"):
        jw.Support.hill(3, pad=15e-3)


def test_a_row_of_rats_whiskers_scans_an_object():
    scene = jw.Scene(jw.Whisker(0.0331, 6.3e-8), jw.Parabola(0.014, 30.0), jw.Support.hill(2))
    result = jw.scan(scene, np.linspace(0.05, 0.0, 21))
    assert np.all(result.status == jw.Status.ok)
    touched = np.asarray(result.phase) != jw.Phase.free
    first = np.flatnonzero(touched[:, 0] & ~touched[:, 1])
    # A follicle whose whisker touches nothing is moved by its neighbour.
    assert np.ptp(np.asarray(result.base_angle)[first, 1]) > 1e-3
