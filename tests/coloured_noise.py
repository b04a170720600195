"""Coloured noise with a known covariance, added to the readings of a log."""

from dataclasses import replace

import numpy as np

from hubodo.gap.state.state import stack_channels

# Size of the noise in units of the declared noise. It is a damped resonance, and a slow part that turns with
# the wheel.
NOISE_SIGMA, DAMPING, RESONANCE = 5.0, 0.9, 0.3  # per sample, of the sample rate
SLOW_RATIO, SLOW_TIME = 0.3, 3.0  # in sigma of the resonance, and s


def compute_resonance_covariance(length):
    """Return the autocorrelation, (length,), of an AR(2) resonance, from its recursion (Yule and Walker)."""
    a, b = 2.0 * DAMPING * np.cos(2.0 * np.pi * RESONANCE), -(DAMPING**2)
    correlation = np.ones(length)
    correlation[1] = a / (1.0 - b)
    for k in range(2, length):
        correlation[k] = a * correlation[k - 1] + b * correlation[k - 2]
    return correlation


def draw_resonance(rng, count):
    """Return noise of unit variance with that autocorrelation, (count,), after its transient."""
    a, b = 2.0 * DAMPING * np.cos(2.0 * np.pi * RESONANCE), -(DAMPING**2)
    noise, white = np.zeros(count + 400), rng.standard_normal(count + 400)
    for k in range(2, len(noise)):
        noise[k] = a * noise[k - 1] + b * noise[k - 2] + white[k]
    correlation = compute_resonance_covariance(3)
    return noise[400:] * np.sqrt(1.0 - a * correlation[1] - b * correlation[2])


def draw_slow_noise(rng, t):
    """Return a Gauss-Markov process, (N,), of unit variance and correlation time SLOW_TIME."""
    decay = np.exp(-np.diff(t) / SLOW_TIME)
    steps = rng.standard_normal(len(t))
    process = np.empty(len(t))
    process[0] = steps[0]
    for k, d in enumerate(decay):
        process[k + 1] = d * process[k] + np.sqrt(1.0 - d * d) * steps[k + 1]
    return process


def with_coloured_noise(evaluation, rng, *, slow_ratio=SLOW_RATIO, added=None):
    """Return the state of an evaluation whose nodes read their prediction plus coloured noise.

    slow_ratio: size of the slow noise, in sigma of the other
    added: further change of the readings of a node, (6, N) in sigma of the noise
    """
    nodes = []
    for node in evaluation.problem.nodes:
        scale = NOISE_SIGMA * evaluation.weights.noise[node.name].sigma.mean(axis=1, keepdims=True)
        angle = evaluation.state.predictions[node.name].rolling.angle
        noise = np.stack(
            [
                draw_resonance(rng, len(node.t))
                + slow_ratio
                * (
                    draw_slow_noise(rng, node.t) * np.cos(angle)
                    + draw_slow_noise(rng, node.t) * np.sin(angle)
                )
                for _ in range(6)
            ]
        )
        y = stack_channels(evaluation.state.predictions[node.name]) + scale * (
            noise + (added or {}).get(node.name, 0.0)
        )
        nodes.append(replace(node, y=y))
    problem = replace(evaluation.problem, nodes=tuple(nodes))
    return replace(evaluation.state, problem=problem)
