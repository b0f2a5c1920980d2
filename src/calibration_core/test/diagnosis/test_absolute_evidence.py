"""Blocks, evidence under dependence inside blocks, and the threshold on the largest candidate."""

from __future__ import annotations

import numpy as np
import pytest

from calibration_core.diagnosis.absolute_design import AbsoluteDesign
from calibration_core.diagnosis.absolute_evidence import LEAST_REST, evidence, project
from calibration_core.diagnosis.blocks import Blocks, posture_blocks, time_blocks
from calibration_core.diagnosis.left_out import block_squares, left_out, saves
from calibration_core.model.effects.candidate import Candidate, Parameter

M, K, NULL = 80, 30, 5  # readings, candidates, null parameters
BLOCKS = Blocks("time", (np.arange(M) * 20 // M).astype(np.int64))


def make_design(residual: np.ndarray, columns: np.ndarray, null: np.ndarray) -> AbsoluteDesign:
    pairs = columns.shape[1] // 2
    parameters = (Parameter("sine", "rad", 1e-4), Parameter("cosine", "rad", 1e-4))
    candidates = tuple(
        Candidate("transmission_error", "absolute", {"joint": f"joint_{k}"}, "order 1", parameters, lambda _: columns)
        for k in range(pairs)
    )
    blocks = tuple(slice(2 * k, 2 * k + 2) for k in range(pairs))
    return AbsoluteDesign(residual, null, columns, candidates, blocks, np.arange(M))


def smooth(rng: np.random.Generator, columns: int) -> np.ndarray:
    """Return (3 M, columns) that change slowly from reading to reading, and hardly within a block."""
    walk = np.cumsum(rng.standard_normal((M, 3, columns)), axis=0)
    return (walk - walk.mean(axis=0)).reshape(3 * M, columns)


@pytest.mark.parametrize("kind", ["white", "same within blocks"])
def test_nothing_passes_where_nothing_is(kind: str) -> None:
    rng = np.random.default_rng(0)
    alarms, draws = 0, 200
    for _ in range(draws):
        columns, null = smooth(rng, 2 * K), rng.standard_normal((3 * M, NULL))
        noise = rng.standard_normal((20, 3))[BLOCKS.label].reshape(-1)
        residual = 0.2 * rng.standard_normal(3 * M) + (noise if kind == "same within blocks" else 0.0)
        alarms += bool(evidence(make_design(residual, columns, null), (), (BLOCKS,)).passing.any())
    assert alarms <= 0.03 * draws  # 1 % expected; 3 % is exceeded by chance in 1 % of such tests


def test_plain_evidence_alone_would_be_fooled() -> None:
    rng = np.random.default_rng(1)
    fooled = 0
    for _ in range(50):
        columns, null = smooth(rng, 2 * K), rng.standard_normal((3 * M, NULL))
        noise = rng.standard_normal((20, 3))[BLOCKS.label].reshape(-1)
        fooled += bool(evidence(make_design(noise, columns, null), (), (BLOCKS,)).plain.max() > 5.0)
    assert fooled > 10  # a fifth, where one in a hundred was meant


def test_what_is_there_passes_and_ranks_first() -> None:
    rng = np.random.default_rng(2)
    columns, null = smooth(rng, 2 * K), rng.standard_normal((3 * M, NULL))
    residual = rng.standard_normal(3 * M) + columns[:, 14] - 0.5 * columns[:, 15] + null @ rng.standard_normal(NULL)
    design = make_design(residual, columns, null)
    scores = evidence(design, (), (BLOCKS,))
    assert scores.passing[7]
    assert np.argmax(scores.plain) == 7
    assert evidence(design, (7,), (BLOCKS,)).plain[7] == -np.inf


def test_aliases_of_the_model_are_not_judged() -> None:
    rng = np.random.default_rng(3)
    columns, null = rng.standard_normal((3 * M, 2 * K)), rng.standard_normal((3 * M, NULL))
    columns[:, 4] = null @ rng.standard_normal(NULL) + 0.1 * LEAST_REST * rng.standard_normal(3 * M)
    columns[:, 7] = columns[:, 6] * 0.7
    judged = project(make_design(rng.standard_normal(3 * M), columns, null), ()).judged
    assert 2 not in judged  # one of its columns is an alias of the null model
    assert 3 not in judged  # its two columns are one
    assert len(judged) == K - 2


def test_blocks_keep_configurations_whole_and_follow_time() -> None:
    configuration = np.repeat(np.random.default_rng(4).permutation(100), 3)
    blocks = time_blocks(configuration, 10)
    assert blocks.count == 10
    assert np.all(np.diff(blocks.label) >= 0)
    assert all(len(np.unique(blocks.label[configuration == c])) == 1 for c in range(100))
    q = np.repeat(np.random.default_rng(5).uniform(-1, 1, (100, 6)), 3, axis=0)
    clusters = posture_blocks(q, configuration, 10)
    assert 5 <= clusters.count <= 10
    assert all(len(np.unique(clusters.label[configuration == c])) == 1 for c in range(100))
    assert np.array_equal(clusters.label, posture_blocks(q, configuration, 10).label)


def test_posture_blocks_are_clusters() -> None:
    centres = np.random.default_rng(6).uniform(-1.5, 1.5, (4, 6))
    owner = np.random.default_rng(7).integers(0, 4, 200)
    q = centres[owner] + 0.01 * np.random.default_rng(8).standard_normal((200, 6))
    clusters = posture_blocks(q, np.arange(200), 4)
    assert clusters.count == 4
    assert all(len(np.unique(owner[clusters.label == b])) == 1 for b in range(4))


def test_left_out_equals_refitting() -> None:
    rng = np.random.default_rng(9)
    columns, residual = rng.standard_normal((3 * M, 6)), rng.standard_normal(3 * M)
    error = left_out(columns, residual, BLOCKS)
    rows = np.repeat(BLOCKS.label, 3) == 3
    solution = np.linalg.lstsq(columns[~rows], residual[~rows], rcond=None)[0]
    assert np.allclose(error[rows], residual[rows] - columns[rows] @ solution)
    used = np.arange(M) != 5
    fitted = np.repeat(used, 3) & ~rows
    solution = np.linalg.lstsq(columns[fitted], residual[fitted], rcond=None)[0]
    assert np.allclose(left_out(columns, residual, BLOCKS, used)[rows], residual[rows] - columns[rows] @ solution)


def test_a_gain_on_one_block_alone_is_no_gain() -> None:
    before = np.full(20, 10.0)
    assert saves(before, before - 1.0)
    one = before.copy()
    one[3] = 0.0
    assert not saves(before, one + 0.1 * (np.arange(20) != 3))
    assert not saves(before, before - 0.001)
    assert np.isclose(block_squares(np.ones(3 * M), BLOCKS).sum(), 3 * M)
