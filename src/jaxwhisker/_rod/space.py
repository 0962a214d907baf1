import equinox as eqx
class SpaceSection(eqx.Module):
    x: int = 0
def space_rod_end(*a): raise NotImplementedError
