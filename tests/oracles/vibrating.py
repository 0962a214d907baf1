"""Vibrations without the package: beams by finite elements, and whiskers in contact by differentiating their energy.

The whisker in contact is a chain whose angle is piecewise linear in arc length. Its potential minus the contact force
times the gap, the least distance of the shaft (or of the tip) from the parabola, is differentiated twice by JAX. No
second variation is derived by hand here. The error falls with the square of the number of cells.
"""

import jax
import jax.numpy as jnp
import numpy as np


def frequencies(stiffness, mass):
    """Angular frequencies in ascending order."""
    inverse = np.linalg.inv(np.linalg.cholesky(mass))
    return np.sqrt(np.linalg.eigvalsh(inverse @ stiffness @ inverse.T))


def beam(cells, *, spring=None, tissue=None, base=None, angle=None, base_mass=0.0):
    """Frequencies of a straight upright beam, EI = L = rho A = 1, by cubic elements; its base is clamped by default.

    Args:
        cells: number of elements.
        spring: (arc length, stiffness) of a spring on the shaft across the beam.
        tissue: (stop, stiffness) of a foundation from the base to an arc length.
        base: stiffness of a spring across the beam at its base, which frees it.
        angle: stiffness of a torsion spring at the base, which frees it.
        base_mass: mass of the base.
    """
    h, n = 1 / cells, 2 * cells + 2
    bent = [[12, 6 * h, -12, 6 * h], [6 * h, 4 * h**2, -6 * h, 2 * h**2]]
    bent += [[-12, -6 * h, 12, -6 * h], [6 * h, 2 * h**2, -6 * h, 4 * h**2]]
    moving = [[156, 22 * h, 54, -13 * h], [22 * h, 4 * h**2, 13 * h, -3 * h**2]]
    moving += [[54, 13 * h, 156, -22 * h], [-13 * h, -3 * h**2, -22 * h, 4 * h**2]]
    bent, moving = np.array(bent) / h**3, np.array(moving) * h / 420
    stiffness, mass = np.zeros((n, n)), np.zeros((n, n))
    for cell in range(cells):
        own = slice(2 * cell, 2 * cell + 4)
        stiffness[own, own] += bent
        mass[own, own] += moving
        if tissue is not None and (cell + 0.5) * h < tissue[0]:
            stiffness[own, own] += tissue[1] * moving
    if spring is not None:
        place = 2 * round(spring[0] * cells)
        stiffness[place, place] += spring[1]
    stiffness[0, 0] += base or 0.0
    stiffness[1, 1] += angle or 0.0
    mass[0, 0] += base_mass
    free = np.r_[[0] * (base is not None), [1] * (angle is not None), 2:n].astype(int)
    return frequencies(stiffness[np.ix_(free, free)], mass[np.ix_(free, free)])


def _shape(base_x, reaction, arcs):
    """Position, angle and curvature of a uniform rod at ascending arc lengths, by Runge-Kutta steps."""
    fx, fy, mz = reaction
    state = np.array([base_x, 0.0, np.pi / 2])

    def rate(state):
        x, y, angle = state
        return np.array([np.cos(angle), np.sin(angle), -mz - (x - base_x) * -fy + y * -fx])

    found = [state]
    for h in np.diff(arcs):
        for _ in range(4):
            a = rate(state)
            b = rate(state + h / 8 * a)
            c = rate(state + h / 8 * b)
            state = state + h / 24 * (a + 2 * b + 2 * c + rate(state + h / 4 * c))
        found.append(state)
    return np.array(found)


def on_parabola(q, x, tip):
    """Gap between a whisker and the parabola y = q + x^2 near a contact at x; of the tip alone, or of the shaft."""

    def gap(right_end, height, here):
        p, ahead = x, 0.0
        for _ in range(4):  # Newton steps for the nearest points of parabola and shaft

            def distance(both):
                p, ahead = both
                right, up = right_end + ahead * jnp.cos(here) - p, height + ahead * jnp.sin(here) - q - p**2
                normal = jnp.stack([2 * p, -1.0]) / jnp.sqrt(1 + 4 * p**2)
                return normal[0] * right + normal[1] * up, (right + 2 * p * up, 2 * p * jnp.cos(here) - jnp.sin(here))

            def equations(both):
                _, (foot, parallel) = distance(both)
                return jnp.stack([foot, both[1] if tip else parallel])

            both = jnp.stack([p, ahead])
            p, ahead = both - jnp.linalg.solve(jax.jacfwd(equations)(both), equations(both))
        return distance(jnp.stack([p, ahead]))[0][None]

    return gap


def rolling_on_parabola(q, x):
    """Distance of the point at which a shaft that has rolled along y = q + x^2 from a contact at x should touch."""

    def arc(p):
        return (2 * p * jnp.sqrt(1 + 4 * p**2) + jnp.arcsinh(2 * p)) / 4

    def miss(right, up, angle):
        p = jnp.tan(angle) / 2
        rolled = jnp.sign(jnp.cos(angle)) * (arc(p) - arc(x))
        return jnp.stack([right + rolled * jnp.cos(angle) - p, up + rolled * jnp.sin(angle) - q - p**2])

    return miss


def held_at(x, y):
    """Distance of a point that is held in place."""
    return lambda right, up, angle: jnp.stack([right - x, up - y])


def on_corner(x, y):
    """Gap between a shaft and a corner."""

    def gap(right, up, angle):
        way = jnp.sign(jnp.cos(angle))
        return way * (jnp.sin(angle) * (right - x) - jnp.cos(angle) * (up - y))[None]

    return gap


def on_face(x, y, slope):
    """Gap between a point and a straight face through (x, y)."""
    return lambda right, up, angle: (jnp.sin(slope) * (right - x) - jnp.cos(slope) * (up - y))[None]


def in_contact(base_x, reaction, arc, contact, forces, spring, cells, rests=False):
    """Frequencies of a uniform whisker (EI = L = rho A = 1) that keeps a contact.

    Args:
        base_x: position of its base, which a spring holds.
        reaction: fx, fy, mz on the whisker.
        arc: contact arc; 1 for the tip.
        contact: a vector that vanishes while the contact is kept, of the position and angle of the whisker there.
        forces: generalised forces of the contact that belong to this vector.
        spring: stiffness of the base's spring.
        cells: number of cells on either side of the contact.
        rests: whether the whisker lies on a straight face from the contact to the tip.

    Returns:
        The frequencies; the vector of the contact and the slope of the energy, which are zero in equilibrium.
    """
    tip = arc >= 1
    arcs = (
        np.linspace(0, 1, 2 * cells + 1)
        if tip
        else np.r_[np.linspace(0, arc, cells + 1), np.linspace(arc, 1, cells + 1)[1:]]
    )
    at = len(arcs) - 1 if tip else cells
    loaded = _shape(base_x, reaction, arcs[: at + 1])
    beyond = loaded[-1, 2] * np.ones(len(arcs) - at - 1)
    angles, steps = np.r_[loaded[:, 2], beyond], np.diff(arcs)
    share = np.array([0.5 - np.sqrt(0.15), 0.5, 0.5 + np.sqrt(0.15)])
    weights = np.array([5, 8, 5]) / 18

    def inside(values):
        return values[:-1, None] + share * (values[1:] - values[:-1])[:, None]

    # The angle of the equilibrium, exact at the Gauss points of each cell: the chain only approximates its change.
    points = _shape(
        base_x, reaction, np.sort(np.r_[arcs[: at + 1], (arcs[:at, None] + share * steps[:at, None]).ravel()])
    )
    exact = points[:, 2][np.arange(len(points)) % 4 != 0].reshape(-1, 3)
    exact = np.concatenate([exact, np.full((len(beyond), 3), loaded[-1, 2])])

    def changed(z):
        """Base, changes of the angles at all nodes, and the angles at the Gauss points."""
        change = jnp.concatenate([jnp.zeros(1), z[1:]])
        return z[0], change, exact + inside(change)

    def kept(z):
        shift, change, angle = changed(z)
        x = base_x + shift + jnp.sum(((jnp.cos(angle) @ weights) * steps)[:at])
        y = jnp.sum(((jnp.sin(angle) @ weights) * steps)[:at])
        miss = contact(x, y, angles[at] + change[at])
        return jnp.concatenate([miss, change[at:]]) if rests else miss

    forces = jnp.concatenate([jnp.array(forces), jnp.zeros(len(arcs) - at if rests else 0)])

    def energy(z):
        shift, change, _ = changed(z)
        rest = base_x + reaction[0] / spring
        bent = jnp.diff(change) / steps
        # The curvature of the equilibrium is exact, too: its mean over a cell is the difference of the angles.
        mean = np.diff(angles) / steps
        return jnp.sum(steps * (bent**2 / 2 + mean * bent)) + spring * (base_x + shift - rest) ** 2 / 2

    z = jnp.zeros(len(arcs))

    def lagrangian(z):
        return energy(z) - forces @ kept(z)

    stiffness, slope = np.asarray(jax.jit(jax.hessian(lagrangian))(z)), jax.jit(jax.grad(lagrangian))(z)

    def kinetic(rate):
        shift, _, _ = changed(rate)
        turn = inside(jnp.concatenate([jnp.zeros(1), rate[1:]]))
        # Positions at the Gauss points: of the cells below, and within the cell by its mean rate.
        right, up = -jnp.sin(exact) * turn, jnp.cos(exact) * turn
        total = jnp.zeros(())
        for part, start in ((right, shift), (up, 0.0)):
            whole = (part @ weights) * steps
            first = start + jnp.cumsum(whole) - whole
            slope = (part[:, 2] - part[:, 0]) / (share[2] - share[0])
            middle = part[:, 1]
            within = steps[:, None] * (middle[:, None] * share + slope[:, None] * (share**2 - share) / 2)
            total += jnp.sum(weights * steps[:, None] * (first[:, None] + within) ** 2)
        return total / 2

    mass = np.asarray(jax.jit(jax.hessian(kinetic))(z))
    across = np.asarray(jax.jit(jax.jacfwd(kept))(z))
    free = np.linalg.svd(across)[2][len(across) :].T
    return frequencies(free.T @ stiffness @ free, free.T @ mass @ free), np.asarray(kept(z)), np.asarray(slope)
