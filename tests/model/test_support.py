"""Supports: named models, mounts, spring lengths, errors."""

# pyright: reportArgumentType=false
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxwhisker as jw

EXACT = 1e-12


def test_named_models():
    assert jw.Support.clamped().name == "clamped"
    for name, springs, whiskers in (("FB", 1, 1), ("FBFB", 2, 2), ("FBFBR", 3, 2), ("FBFBFBR", 5, 3)):
        support = jw.Support.named(name, 70.0, 0.2)
        assert (support.name, len(support.springs), support.whiskers) == (name, springs, whiskers)
        flexibility = support.flexibility()
        assert flexibility is not None
        np.testing.assert_allclose(flexibility.offset, 0.2 * np.arange(1, whiskers + 1), atol=EXACT)
    assert jw.Support((jw.Spring((0, 2), 1.0), jw.Spring((1, 2), 1.0))).name == "network"
    assert jw.Support.follicle(phi=3.0).name == "follicle"


@pytest.mark.parametrize("length", [1.0, 80.0, 0.08])
def test_default_rest_lengths_scale_with_the_first_whisker(length):
    whiskers = (jw.Whisker(length), jw.Whisker(3 * length), jw.Whisker(length))
    for each in (
        jw.Scene(whiskers, jw.Parabola(0.2 * length), jw.Support.fbfbfbr(5.0)),
        jw.Sensor(whiskers, jw.Support.fbfbfbr(5.0)),
    ):
        found = [spring.rest_length for spring in each.support.springs]
        assert found == [spring.rest_length for spring in jw.Support.fbfbfbr(5.0, 0.2 * length).springs]
    loose = jw.Support((jw.Spring((0, 1), 5.0, None), jw.Spring((2, 1), 5.0, None), jw.Spring((0, 2), 5.0, 0.3)))
    found = jw.Sensor(jw.Whisker(length), loose).support.springs
    assert [spring.rest_length for spring in found] == [0.2 * length, -0.2 * length, 0.3]
    held = jw.deflect(jw.Whisker(length), jw.PointForce(1e-3 / length**2), support=jw.Support.fb(1e9), points=2)
    np.testing.assert_allclose(held.base_x, 0.2 * length, rtol=1e-6)  # where the stiff spring holds it


def test_default_rest_lengths_have_a_derivative_by_the_length():
    def rest(length):
        return jw.Sensor(jw.Whisker(length), jw.Support.fbfbr(5.0)).support.springs[2].rest_length

    for slope in (jax.grad(rest), jax.jacfwd(rest), jax.jit(jax.grad(rest))):
        np.testing.assert_allclose(slope(0.08), 0.4, rtol=EXACT)
    np.testing.assert_allclose(jax.vmap(rest)(jnp.array([1.0, 0.08])), [0.4, 0.032], rtol=EXACT)


def test_a_support_without_a_scene_has_a_flexibility_but_no_place():
    flexibility, known = jw.Support.fbfbr(5.0).flexibility(), jw.Support.fbfbr(5.0, 0.2).flexibility()
    assert flexibility is not None and known is not None
    np.testing.assert_array_equal(flexibility.matrix, known.matrix)
    assert np.isnan(flexibility.offset).all()


def test_a_clamped_support_has_no_flexibility():
    for support in (jw.Support.clamped(), jw.Support.follicle()):
        flexibility = support.flexibility()
        assert flexibility.matrix.shape == (support.whiskers, support.whiskers)
        assert not np.any(flexibility.matrix) and not np.any(flexibility.offset) and flexibility.consistent


def test_axes_are_those_of_the_springs():
    support = jw.Support.follicle(y=30.0, phi=8.0)
    assert support.axes == ("y", "phi")
    assert [spring.stiffness for spring in support.along("phi")] == [8.0]
    flexibility = support.flexibility()
    assert flexibility is not None
    np.testing.assert_allclose(flexibility.matrix, np.diag([0.0, 1 / 30, 1 / 8]), atol=EXACT)


def test_mounts_give_the_number_of_clamped_whiskers():
    mounts = (jw.Mount(), jw.Mount(0.3), jw.Mount(0.6))
    assert jw.Support(mount=mounts).whiskers == 3
    assert jw.Support(mount=mounts).mounts == mounts
    assert jw.Support(jw.Support.fbfb(1.0).springs, jw.Mount(y=0.1)).mounts == (jw.Mount(y=0.1),) * 2
    assert jw.Support.fbfb(1.0).mounts == (jw.Mount(),) * 2


def test_spring_lengths():
    support = jw.Support((jw.Spring((0, 1), 1.0), jw.Spring((1, 2), 1.0), jw.Spring((0, 2), 1.0, axis="phi")))
    at = jnp.array([[0.1, 0.2, 0.3], [0.5, 0.7, 1.1]])  # x, y, angle of both bases
    np.testing.assert_allclose(support.spring_length(at), [0.1, 0.4, 1.1], atol=EXACT)
    assert jw.Support.clamped().spring_length(at[:, :1]).shape == (0,)


def test_spring_lengths_in_space():
    springs = [jw.Spring((0, 1), 1.0, axis=axis) for axis in ("phi_x", "z", "phi")]
    support = jw.Support((*springs, jw.Spring((1, 2), 1.0, axis="z")))
    at = jnp.arange(12.0).reshape(2, 6)  # x, y, z, phi_x, phi_y, phi_z of both bases
    np.testing.assert_allclose(support.spring_length(at), [3.0, 2.0, 5.0, 6.0], atol=EXACT)


def test_a_follicle_in_space_has_springs_along_six_axes():
    support = jw.Support.follicle(1.0, 2.0, 3.0, z=4.0, phi_x=5.0, phi_y=6.0)
    assert support.axes == ("x", "y", "z", "phi_x", "phi_y", "phi")
    assert support.name == "follicle"
    np.testing.assert_allclose(
        np.diag(support.flexibility_in_space().matrix), [1, 1 / 2, 1 / 4, 1 / 5, 1 / 6, 1 / 3], atol=EXACT
    )
    assert jw.Support.follicle(z=4.0).name == "follicle"


OUTSIDE = [
    (jw.Support.follicle(x=9.0, z=1.0), r"`axis` must be one of x, y, phi, axial in the plane: .* in space, got 'z'"),
    (jw.Support.follicle(phi_x=1.0), "`axis` must be one of .* in the plane: .* in space, got 'phi_x'"),
    (jw.Support(mount=jw.Mount(z=0.1)), r"`z` must be None in the plane: others need an object in space, got 0\.1"),
    (jw.Support.follicle(1.0, mount=jw.Mount(elevation=0.2)), r"`elevation` must be None in the plane: .*, got 0\.2"),
    (jw.Support(mount=(jw.Mount(roll=0.0),)), "`roll` must be None in the plane: others need .*, got 0"),
]


@pytest.mark.parametrize(("support", "message"), OUTSIDE)
@pytest.mark.parametrize(
    "use",
    [
        lambda support: jw.Sensor(jw.Whisker(), support),
        lambda support: jw.Scene(jw.Whisker(), jw.Parabola(0.2), support),
        lambda support: jw.deflect(jw.Whisker(), jw.PointForce(0.1), support=support),
        lambda support: jw.modes(jw.Whisker(mass_per_length=1.0), support=support),
        lambda support: support.flexibility(),
    ],
)
def test_the_plane_has_no_room_for_supports_in_space(use, support, message):
    with pytest.raises(ValueError, match=message):
        use(support)


@pytest.mark.parametrize(
    ("support", "message"),
    [
        (jw.Support((jw.Spring((0, 1), 1.0, at=0.1),), free=("phi",)), r"`at` must be None in space, got 0\.1"),
        (jw.Support((jw.Spring((0, 1), 1.0, anchor=(0.0, 0.1)),)), r"`anchor` must be None in space, got \(0"),
        (
            jw.Support((jw.Spring((0, 1), 1.0, 0.1, "axial"),)),
            "`axis` must be one of x, y, z, .* in space, got 'axial'",
        ),
        (
            jw.Support((jw.Spring((0, 1), 1.0, one_sided="tension"),)),
            "`one_sided` must be None in space, got 'tension'",
        ),
        (jw.Support((jw.Spring((0, 1), jnp.sinh),)), "`stiffness` must be a number in space, got sinh"),
        (jw.Support(foundation=jw.Foundation(0.0, 0.1, 9.0)), "`foundation` must be None in space, got Foundation"),
    ],
)
def test_space_has_no_room_for_springs_on_shafts(support, message):
    with pytest.raises(ValueError, match=message):
        support.check_in_space()
    with pytest.raises(ValueError, match=message):
        support.flexibility_in_space()


def test_space_has_room_for_supports_of_the_plane():
    for support in (jw.Support(), jw.Support.fbfbr(1.0), jw.Support.follicle(1.0, z=2.0, mount=jw.Mount(roll=0.1))):
        support.check_in_space()


def test_traced_parameters_out_of_their_domain_are_invalid():
    @jax.jit
    def valid(stiffness, angle):
        return jw.Support.follicle(x=stiffness, mount=jw.Mount(angle=angle)).valid()

    @jax.jit
    def valid_in_space(z, elevation, roll):
        return jw.Support(mount=jw.Mount(z=z, elevation=elevation, roll=roll)).valid()

    assert valid_in_space(-0.1, 2.0, 4.0)
    for bad in [(jnp.nan, 2.0, 4.0), (-0.1, jnp.inf, 4.0), (-0.1, 2.0, jnp.nan)]:
        assert not valid_in_space(*bad)

    assert valid(70.0, 1.5) and valid(jnp.inf, -1.5)
    assert not valid(-70.0, 1.5) and not valid(70.0, 2.0) and not valid(70.0, jnp.nan)


@pytest.mark.unchecked
@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: jw.Support((jw.Spring((0, 1), 1.0), jw.Spring((2, 3), 1.0))), "`springs` must connect .* base 2"),
        (lambda: jw.Support((jw.Spring((0, 3), 1.0),)), "`springs` must connect every base from 1 to 3 .* base 1 "),
        (
            lambda: jw.Support((*jw.Support.fbfb(1.0).springs, jw.Spring((1, 2), 1.0, axis="phi"))),
            "`springs` must connect .* base 1 along phi",
        ),
        (lambda: jw.Support((70.0,)), "`springs` must be a tuple of Spring, got"),
        (lambda: jw.Support(mount=3.0), "`mount` must be a Mount or a tuple of them, got 3.0"),
        (
            lambda: jw.Support((jw.Spring((0, 1), 1.0),), (jw.Mount(), jw.Mount())),
            r"`mount` must be one Mount or one per base \(1\), got 2 of them",
        ),
        (
            lambda: jw.Support((*jw.Support.fbfb(1.0).springs, jw.Spring((1, 2), 1.0, axis="z"))),
            "`springs` must connect .* base 1 along z",
        ),
        (
            lambda: jw.Support((*(jw.Spring((0, k), 1.0, at=0.1) for k in (1, 2)), jw.Spring((1, 2), 1.0, axis="z"))),
            "`springs` must connect .* base 1 along z",
        ),
        (lambda: jw.Mount(z="a"), "`z` must be a finite number, got 'a'"),
        (lambda: jw.Mount(roll=jnp.nan), "`roll` must be a finite number, got nan"),
        (lambda: jw.Mount(angle=2.0), "`angle` must be less than a right angle, got 2 rad"),
        (lambda: jw.Support.fbfbr(jnp.inf, [0.2, 0.2, 0.5]), "`rest_length` must be the same along all paths"),
        (
            lambda: jw.Sensor(
                jw.Whisker(3.0), jw.Support(jw.Support.fb(jnp.inf).springs + jw.Support.fb(jnp.inf, 0.2).springs)
            ),
            r"`rest_length` must be the same along all paths .*, got \[0.6\d*, 0.2\]",
        ),
        (lambda: jw.Support.named("BFF", 70.0), "`model` must be one of clamped, FB, FBFB, .*, got 'BFF'"),
    ],
)
def test_wrong_supports(make, message):
    with pytest.raises(ValueError, match=message):
        make()
