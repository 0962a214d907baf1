# ---
# jupyter:
#   jupytext:
#     formats: py:percent
# ---

# %% [markdown]
# # A posterior for the stiffness of springs
#
# After this notebook you can sample the posterior of identified parameters and compare
# it with their standard errors.
#
# `jw.identify` computes standard errors from the curvature of the misfit at its
# minimum. With few samples or much noise the misfit is not a parabola. The likelihood
# can then be sampled: `fit.log_density` is its logarithm, with derivatives. The
# notebook needs `pip install 'jaxwhisker[posterior]'` and takes about three minutes on
# two cores.

# %%
import jax

jax.config.update("jax_enable_x64", True)

import blackjax
import jax.numpy as jnp
import numpy as np
from matplotlib import pyplot

import jaxwhisker as jw

SAMPLES, WARMUP = 300, 150


def build(c, q):
    return jw.Scene(jw.Whisker(), jw.Parabola(q), jw.Support.fb(c), rod=jw.ClosedForm())


# %% [markdown]
# A short scan of one whisker on a spring of stiffness 60, with noise of a tenth of the
# peak.

# %%
noise = {"fx": 0.5, "fy": 1.0, "mz": 0.45}
control = np.linspace(0.7, -1.0, 60)
rng = np.random.default_rng(1)
truth = {"c": 60.0, "q": 0.3}
scan = jw.scan(build(**truth), control)
measured = {"control": control} | {
    name: np.asarray(getattr(scan, name)) + sigma * rng.standard_normal(scan.fx.shape)
    for name, sigma in noise.items()
}
fit = jw.identify(build, {"c": 80.0, "q": 0.25}, measured, sigma=noise)
print(fit)

# %% [markdown]
# The No-U-Turn sampler on this density. The variables are logarithms (`fit.variables`,
# `fit.parameters`); without an additional term, the prior is flat in them.

# %%
key_warmup, key_run = jax.random.split(jax.random.key(0))
tuning = blackjax.window_adaptation(
    blackjax.nuts, fit.log_density, target_acceptance_rate=0.8
)
(state, tuned), _ = tuning.run(key_warmup, jnp.asarray(fit.variables), num_steps=WARMUP)
kernel = jax.jit(blackjax.nuts(fit.log_density, **tuned).step)
drawn = []
for key in jax.random.split(key_run, SAMPLES):
    state, _ = kernel(key, state)
    drawn.append(np.asarray(state.position))
posterior = {
    name: np.asarray(v)
    for name, v in jax.vmap(fit.parameters)(jnp.array(drawn)).items()
}

# %%
for name, values in posterior.items():
    low, high = np.quantile(values, [0.025, 0.975])
    at, error = fit.estimates[name], fit.standard_error[name]
    print(f"{name}: posterior {values.mean():.5g} +- {values.std():.2g},", end=" ")
    print(f"95 % {low:.5g} to {high:.5g}; least squares {at:.5g} +- {error:.2g}")
    assert abs(values.mean() - at) < error
    assert low < truth[name] < high

# %%
turn = np.linspace(0, 2 * np.pi, 100)
circle = np.sqrt(5.99) * np.array([np.cos(turn), np.sin(turn)])
c, q = np.linalg.cholesky(fit.covariance) @ circle
figure, ax = pyplot.subplots(figsize=(5, 3.5), layout="constrained")
ax.plot(posterior["c"], posterior["q"], ".", markersize=3, label="posterior")
ax.plot(fit.estimates["c"] + c, fit.estimates["q"] + q, label="95 % by least squares")
ax.plot(*truth.values(), "k+", markersize=10, label="truth")
ax.set(xlabel=r"$c\,L^3/EI$", ylabel="$q/L$")
legend = ax.legend(frameon=False)

# %% [markdown]
# Stiff springs are hard to distinguish. The posterior therefore has a tail towards
# stiff springs, which the ellipse around the estimate does not have. The true value
# lies in this tail here.
#
# ## Something to try
#
# Leave out every second sample, or all samples before the vertex. When do posterior and
# ellipse disagree?
