"""The progress bar of a study."""


def bar(points: int, steps: int, done: int, shown: bool | None):
    """A tqdm bar that counts equilibria; `shown` None: on a terminal only."""
    from tqdm import tqdm

    return tqdm(
        total=points * steps,
        initial=done * steps,
        desc="study",
        unit=" equilibria",
        unit_scale=True,
        disable=None if shown is None else not shown,
    )
