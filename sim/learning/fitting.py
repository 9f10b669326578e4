"""``fit``: a policy from samples, by scikit-learn's multilayer perceptron.

scikit-learn is the smallest of the well-kept trainers (10 MB; PyTorch for the CPU takes 200, JAX
with optax 100), and a network of 10,000 weights needs nothing that it lacks. The same samples and
seed give the same policy on one machine.
"""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planner.errors import TaskError
from sim.learning.policy import Policy, PolicyFor, normalised

HIDDEN = (64, 64)
"""Units of the hidden layers."""

STAGES = ((1e-3, 0.6), (3e-4, 0.25), (1e-4, 0.15))
"""Learning rates, and the share of the epochs with each."""

BATCH, DECAY = 256, 30.0
"""Samples per step of Adam, and scikit-learn's ``alpha``, which it divides by them. So strong a
decay explains 0.5 of the squares of the actions wanted in unseen episodes, 1.0 only 0.3 (33
episodes of round 0: errors of joints are drawn once per episode, and so few are learned by
heart)."""

LEAST_SCALE = 1e-2
"""Least standard deviation by which a sense is divided: one that never changed stays near 0."""

NEEDS_SKLEARN = (
    'training needs scikit-learn: pip install "opposable[learn]"; running a policy does not'
)


def fit(
    about: PolicyFor,
    senses: NDArray[np.float32],
    wanted: NDArray[np.float32],
    *,
    epochs: int,
    seed: int,
) -> Policy:
    """A policy that gives the wanted actions for the senses, least squares.

    Args:
        about: What it is for.
        senses: (k, m).
        wanted: (k, nu), in [-1, 1].
        epochs: Passes over all samples.
        seed: Of first weights and order.

    Raises:
        TaskError: scikit-learn is not installed, or there are no samples.
    """
    if len(senses) == 0:
        raise TaskError("there are no samples to learn from; collect episodes first")
    mean, scale = senses.mean(axis=0), np.maximum(senses.std(axis=0), np.float32(LEAST_SCALE))
    # actions are a few hundredths, and first weights are made for outputs of size 1
    unit = max(float(wanted.std()), LEAST_SCALE)
    inputs = normalised(senses, mean, scale)
    network = trained_network(inputs, wanted / unit, epochs=epochs, seed=seed)
    weights, biases = list(network.coefs_), list(network.intercepts_)
    weights[-1], biases[-1] = unit * weights[-1], unit * biases[-1]
    return Policy(
        about=about,
        mean=mean,
        scale=scale,
        weights=tuple(w.astype(np.float32) for w in weights),
        biases=tuple(b.astype(np.float32) for b in biases),
    )


def trained_network(
    inputs: NDArray[np.float32], wanted: NDArray[np.float32], *, epochs: int, seed: int
) -> Any:
    """scikit-learn's ``MLPRegressor`` after so many passes over the samples, at falling rates.

    Raises:
        TaskError: scikit-learn is not installed.
    """
    try:
        from sklearn.exceptions import ConvergenceWarning
        from sklearn.neural_network import MLPRegressor
    except ImportError as error:
        raise TaskError(NEEDS_SKLEARN) from error
    network = MLPRegressor(
        hidden_layer_sizes=HIDDEN,
        batch_size=min(BATCH, len(inputs)),
        alpha=DECAY,
        random_state=seed,
        warm_start=True,
        tol=0.0,
        n_iter_no_change=epochs + 1,
    )
    for rate, share in STAGES:
        network.set_params(learning_rate_init=rate, max_iter=max(1, round(share * epochs)))
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ConvergenceWarning)  # the epochs are what was asked for
            network.fit(inputs, wanted)
    return network
