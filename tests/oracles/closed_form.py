"""States of one whisker on a spring at a parabola, by elliptic integrals to forty digits, for exact derivatives.

theta = phi - alpha has the value theta1 at the contact; k = sin((pi/2 - theta1)/2), sin t0 = sin(alpha/2)/k for a
vertical clamp, dF = K(k) - F(t0, k), dE = E(k) - E(t0, k). Relative to the base, the contact lies at
T = 2 k cos(t0)/sqrt f along the object's tangent and N = (2 dE - dF)/sqrt f along its normal, with s1 = dF/sqrt f
(elastica in tangential or tip contact; units L = EI = 1, others by scaling).
"""

import mpmath as mp

DIGITS = 40
mp.mp.dps = DIGITS
ROOT = mp.mpf(10) ** -60  # square of the largest residual at a root
STEP = mp.mpf(10) ** -10  # of differences, whose error is its square

PARAMETERS = ("u", "stiffness", "rest_length", "distance", "a", "length", "bending_stiffness")
FIELDS = ("fx", "fy", "mz", "base_x", "contact_force", "contact_slope", "contact_arc", "contact_x", "contact_y")


def _near(guess):
    """Two nearby points for the secant method, whose default takes a distant second point."""
    return guess, guess + mp.mpf(10) ** -6


def _shape(alpha, k):
    """T, N and s1, each times sqrt f."""
    t0 = mp.asin(mp.sin(alpha / 2) / k)
    m = k * k
    arc = mp.ellipk(m) - mp.ellipf(t0, m)
    across = 2 * (mp.ellipe(m) - mp.ellipe(t0, m)) - arc
    along = 2 * k * mp.cos(t0)
    return along, across, arc


def _contact(alpha, k, tip, distance, a):
    """Force, base and contact of a clamped whisker that touches at slope alpha; residual of the tip's height."""
    along, across, arc = _shape(alpha, k)
    height = along * mp.sin(alpha) + across * mp.cos(alpha)
    xi, eta = mp.tan(alpha) / (2 * a), distance + mp.tan(alpha) ** 2 / (4 * a)
    root = arc if tip else height / eta  # sqrt f
    base_x = xi - (along * mp.cos(alpha) - across * mp.sin(alpha)) / root
    return root**2, base_x, xi, eta, along * root, arc / root, height / root - eta


def state(tip, guess, u, stiffness, rest_length, distance, a, length, bending_stiffness):
    """The fields of a state near a guess of alpha, or of (alpha, k) in tip contact."""
    force_unit = bending_stiffness / length**2
    c, spare = stiffness * length / force_unit, (u + rest_length) / length
    q, bow = distance / length, a * length

    def residuals(alpha, k):
        f, base_x, _, _, _, _, height = _contact(alpha, k, tip, q, bow)
        return base_x - spare - f * mp.sin(alpha) / c, height

    if tip:
        alpha, k = mp.findroot(residuals, guess, tol=ROOT)
    else:
        k = mp.sqrt(mp.mpf(1) / 2)
        alpha = mp.findroot(lambda alpha: residuals(alpha, k)[0], _near(guess[0]), tol=ROOT)
    f, base_x, xi, eta, bend, arc, _ = _contact(alpha, k, tip, q, bow)
    return {
        "fx": -f * mp.sin(alpha) * force_unit,
        "fy": f * mp.cos(alpha) * force_unit,
        "mz": bend * force_unit * length,
        "base_x": base_x * length,
        "contact_force": f * force_unit,
        "contact_slope": alpha,
        "contact_arc": arc * length,
        "contact_x": xi * length,
        "contact_y": eta * length,
    }


def modulus(alpha, force, arc):
    """k of a tip contact with this force and arc, L = EI = 1; a guess for `state`."""
    # The angle to the object, pi/2 - 2 asin(k), is between 0 and that of a straight whisker.
    bracket = abs(mp.sin(mp.mpf(alpha) / 2)) * (1 + STEP), mp.sqrt(mp.mpf(1) / 2)
    return mp.findroot(lambda k: _shape(alpha, k)[2] - mp.sqrt(force) * arc, bracket, solver="anderson", tol=1e-20)


def snap_off(guess, stiffness, rest_length, distance, a):
    """Drive position at which tip contact is lost, L = EI = 1: the smallest u on the branch."""

    def control(k):
        def slope(alpha):
            return _contact(alpha, k, True, distance, a)[-1]

        alpha = mp.findroot(slope, _near(guess[0]), tol=ROOT)
        f, base_x, *_ = _contact(alpha, k, True, distance, a)
        return base_x - rest_length - f * mp.sin(alpha) / stiffness

    def turns(k):
        return (control(k + STEP) - control(k - STEP)) / (2 * STEP)

    return control(mp.findroot(turns, _near(guess[1]), tol=mp.mpf(10) ** -36))
