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


def in_contact(base_x, reaction, force, arc, q, spring, cells):
    """Frequencies of a uniform whisker (EI = L = rho A = 1) that touches the parabola y = q + x^2.

    Args:
        base_x: position of its base, which a spring holds.
        reaction: fx, fy, mz on the whisker.
        force: contact force.
        arc: contact arc; 1 for the tip, whose gap is then that of the tip alone.
        q: height of the parabola's vertex.
        spring: stiffness of the base's spring.
        cells: number of cells on either side of the contact.

    Returns:
        The frequencies; the gap and the slope of the energy, which are zero in equilibrium.
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

    def gap(z):
        shift, change, angle = changed(z)
        x = base_x + shift + jnp.sum(((jnp.cos(angle) @ weights) * steps)[:at])
        y = jnp.sum(((jnp.sin(angle) @ weights) * steps)[:at])
        here, ahead = angles[at] + change[at], 0.0
        p = x_contact
        for _ in range(4):  # Newton steps for the nearest points of parabola and shaft

            def distance(both):
                p, ahead = both
                right, up = x + ahead * jnp.cos(here) - p, y + ahead * jnp.sin(here) - q - p**2
                normal = jnp.stack([2 * p, -1.0]) / jnp.sqrt(1 + 4 * p**2)
                return normal[0] * right + normal[1] * up, (right + 2 * p * up, 2 * p * jnp.cos(here) - jnp.sin(here))

            def equations(both):
                _, (foot, parallel) = distance(both)
                return jnp.stack([foot, both[1] if tip else parallel])

            both = jnp.stack([p, ahead])
            p, ahead = both - jnp.linalg.solve(jax.jacfwd(equations)(both), equations(both))
        return distance(jnp.stack([p, ahead]))[0]

    x_contact = loaded[-1, 0]

    def energy(z):
        shift, change, _ = changed(z)
        rest = base_x + reaction[0] / spring
        bent = jnp.diff(change) / steps
        # The curvature of the equilibrium is exact, too: its mean over a cell is the difference of the angles.
        mean = np.diff(angles) / steps
        return jnp.sum(steps * (bent**2 / 2 + mean * bent)) + spring * (base_x + shift - rest) ** 2 / 2

    z = jnp.zeros(len(arcs))
    lagrangian = jax.jit(jax.hessian(lambda z: energy(z) - force * gap(z)))
    slope = jax.grad(lambda z: energy(z) - force * gap(z))(z)

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
    across = np.asarray(jax.grad(gap)(z))[None]
    kept = np.linalg.svd(across)[2][1:].T
    return (
        frequencies(kept.T @ np.asarray(lagrangian(z)) @ kept, kept.T @ mass @ kept),
        float(gap(z)),
        np.asarray(slope),
    )
