"""Port of the thesis's algorithm: scipy's fsolve around solve_ivp, tangential contact first, then tip contact.

The rod is shot from the base, whose curvature follows from the unknowns, to the contact. The unknowns are
(f, alpha, s1) in tangential contact and (f, alpha) in tip contact. Every solve starts from the last solution in the
same phase.
"""

import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import fsolve

from peers.scene import CONTACT_SLOPE, Scene


def scan(scene: Scene, control: np.ndarray, rtol: float) -> np.ndarray:
    """Support reactions fx, fy, mz at every drive position, (steps, 3)."""

    def shot(u, f, alpha, s1):
        force = f * np.sin(alpha), -f * np.cos(alpha)
        x0 = u + scene.rest_length + force[0] / scene.stiffness
        contact = scene.contact(alpha)

        def bend(_, state):
            x, y, phi = state
            return np.cos(phi), np.sin(phi), (contact[0] - x) * force[1] - (contact[1] - y) * force[0]

        end = solve_ivp(bend, (0, s1), (x0, 0.0, np.pi / 2), rtol=rtol, atol=rtol * 1e-2).y[:, -1]
        return end - (*contact, alpha), (-force[0], -force[1], -bend(0, (x0, 0.0, 0.0))[2])

    tangential, tip = np.array([0.5, CONTACT_SLOPE, 0.99]), np.array([0.01, CONTACT_SLOPE])
    reactions = []
    for u in control:
        z, _, code, _ = fsolve(lambda z, u=u: shot(u, *z)[0], tangential, xtol=rtol, full_output=True)
        if code == 1 and 0 < z[2] <= 1:
            tangential = z
        else:
            tip = fsolve(lambda z, u=u: shot(u, *z, 1.0)[0][:2], tip, xtol=rtol)
            z = *tip, 1.0
        reactions.append(shot(u, *z)[1])
    return np.array(reactions)
