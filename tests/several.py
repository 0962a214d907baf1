"""A scan in which the whisker has two contacts: for the tests of everything that users do with results."""

from functools import cache

import jax.numpy as jnp
import numpy as np

import jaxwhisker as jw

CONTROL = np.linspace(0.3, -1.45, 71)  # two contacts between -0.588 and -0.750
BOTH = np.flatnonzero((CONTROL < -0.6) & (CONTROL > -0.74))  # steps with two contacts
EVENTS = (
    "touch of whisker 1 with object 1 at contact 1",
    "touch of whisker 1 with object 2 at contact 2",
    "tangential_to_tip of whisker 1 on object 1 at contact 1",
    "release of whisker 1 from object 1 at contact 1",
    "tangential_to_tip of whisker 1 on object 2 at contact 1",
    "snap_off of whisker 1",
)


def circles(distance=0.25, contacts=2):
    """A whisker that bends over one circle before it leaves another one."""
    objects = jw.Circle(0.5, 0.2), jw.Circle(distance, 0.12, position=-0.55)
    return jw.Scene(jw.Whisker(), objects, contacts=contacts)


@cache
def scanned():
    return jw.scan(circles(), CONTROL)


def with_one_contact(result):
    """The outermost contacts of a scan, as a result of whiskers that can have only one."""
    fields = {name: getattr(result, name) for name in jw.Result.__dataclass_fields__}
    fields |= {name: value[..., 0] for name, value in fields.items() if getattr(value, "ndim", 0) == 3}
    return jw.Result(**fields | {"scene": circles(contacts=1)})


def wavy(x):
    """A concave object: its ends are below its highest places."""
    return 0.3 + 0.1 * jnp.cos(6 * x)
