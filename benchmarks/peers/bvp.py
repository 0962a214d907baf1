"""Boundary value problem, solved with scipy's solve_bvp; unknown parameters are f, alpha and, if tangential, s1."""

import numpy as np
from scipy.integrate import solve_bvp

from peers.scene import CONTACT_SLOPE, Scene

NODES = 11  # of the first mesh, which solve_bvp refines


def scan(scene: Scene, control: np.ndarray, tol: float) -> np.ndarray:
    """Support reactions fx, fy, mz at every drive position, (steps, 3)."""
    sigma = np.linspace(0, 1, NODES)
    guess = sigma, np.stack([np.full(NODES, np.sqrt(0.8)), sigma, np.full(NODES, np.pi / 2)]), (0.01, CONTACT_SLOPE)
    tip, reactions = True, []
    for u in control:

        def base_x(f, alpha, u=u):
            return u + scene.rest_length + f * np.sin(alpha) / scene.stiffness

        def bend(_, state, p):
            x, y, phi = state
            (f, alpha), s1 = p[:2], (1.0 if len(p) == 2 else p[2])
            xi, eta = scene.contact(alpha)
            kappa = -f * ((xi - x) * np.cos(alpha) + (eta - y) * np.sin(alpha))
            return s1 * np.stack([np.cos(phi), np.sin(phi), kappa])

        def ends(base, contact, p):
            xi, eta = scene.contact(p[1])
            misses = [base[0] - base_x(*p[:2]), base[1], base[2] - np.pi / 2, contact[0] - xi, contact[1] - eta]
            return np.array(misses if len(p) == 2 else [*misses, contact[2] - p[1]])

        solution = solve_bvp(bend, ends, *guess, tol=tol)
        over = solution.y[2, -1] < solution.p[1] if tip else solution.p[2] > 1
        if over:  # switch to the other phase
            tip = not tip
            parameters = solution.p[:2] if tip else (*solution.p, 1.0)
            solution = solve_bvp(bend, ends, solution.x, solution.y, parameters, tol=tol)
        guess = solution.x, solution.y, solution.p
        f, alpha = solution.p[:2]
        xi, eta = scene.contact(alpha)
        moment = f * ((xi - base_x(f, alpha)) * np.cos(alpha) + eta * np.sin(alpha))
        reactions.append((-f * np.sin(alpha), f * np.cos(alpha), moment))
    return np.array(reactions)
