"""Kernels of transport refuse arrays that do not fit one another."""

import numpy as np
import pytest
from photonrelax._ext.transport.deposits import DEPOSIT, Columns

from photonrelax import gallery
from photonrelax._ext.transport import emission as emission_kernel
from photonrelax._ext.transport import hit_points, trace
from photonrelax.transport.batch import TraceContext, TraceSettings
from photonrelax.transport.emission import plan_emission
from photonrelax.transport.raycast import empty_intersections

N = 8


@pytest.fixture(scope="module")
def context():
    scene = gallery.scene("ring", pixels=4, sections=16)
    settings = TraceSettings(paths="caustic", max_bounces=4, frequency_share=0.0)
    return TraceContext(scene, plan_emission(scene, 100), settings, N)


def started(context, n, **odd):
    """Start n photons of two regions, given arrays of odd shapes."""
    shapes = {"luminance": (2, 3), "ledger": (2, 5, 3), "ends": (2, 5), "media": (2,)} | odd
    types = {"ends": np.int64, "media": np.uint64}
    arrays = {name: np.ones(shape, types.get(name, float)) for name, shape in shapes.items()}
    counts = arrays.pop("counts", np.ones(2)).astype(np.int64) * (n // 2)
    context.acquire_paths().start([context.emissions[0]] * 2, counts, np.arange(n), **arrays)


@pytest.mark.parametrize(
    "odd",
    [
        *({"luminance": shape} for shape in ((2, 2), (1, 3))),
        *({"ledger": shape} for shape in ((2, 4, 3), (1, 5, 3))),
        *({"ends": shape} for shape in ((2, 4), (1, 5))),
        {"media": (1,)},
        {"counts": (1,)},
    ],
)
def test_paths_want_a_ledger_of_all_outcomes(context, odd):
    started(context, N)
    with pytest.raises(ValueError, match="do not fit the photons"):
        started(context, N, **odd)


def test_paths_want_a_row_of_the_ledger_for_each_block(context):
    n = 2 * trace.LEDGER_BLOCK + 2
    long = TraceContext(context.scene, context.plan, context.settings, n)
    started(long, n, ledger=(4, 5, 3), ends=(4, 5))
    with pytest.raises(ValueError, match="do not fit the photons"):
        started(long, n, ledger=(3, 5, 3), ends=(4, 5))


def test_crossings_are_of_live_rays(context):
    paths = context.acquire_paths()
    context.start(paths, np.array([0]), np.array([N]), np.arange(N))
    found, hits = context.caster.find_paths(paths), empty_intersections(N)
    with pytest.raises(ValueError, match="do not fit one another"):
        paths.cross(found, np.arange(N - 1), hits)
    for first in (-1, 1):
        with pytest.raises(ValueError, match=f"should be of {N} live rays, but are {first} to"):
            paths.cross(found, np.arange(first, first + N), hits)


def test_hits_are_replaced_by_as_many(context):
    rays = (np.ones((3, 3), np.float32),) * 2
    found = context.caster.find(*rays)
    with pytest.raises(ValueError, match="found should be of 2 rays, but is of 3"):
        found.replace(np.arange(2), context.caster.find(*rays))


COLUMNS = {
    **dict.fromkeys(("position", "normal", "wi", "flux", "emitter_coords"), (N, 3)),
    **dict.fromkeys(("emitter_density", "emitter_id", "path_signature"), (N,)),
    **dict.fromkeys(("n_bounces", "path_length", "object_id"), (N,)),
}
DTYPES = {"path_signature": np.int64} | dict.fromkeys(
    ("emitter_id", "n_bounces", "object_id"), np.int32
)


def columns(**odd):
    shapes = COLUMNS | odd
    return Columns(
        **{name: np.zeros(shape, DTYPES.get(name, float)) for name, shape in shapes.items()}
    )


@pytest.mark.parametrize(
    "odd", [*({name: (N - 1, *shape[1:])} for name, shape in COLUMNS.items()), {"wi": (N, 2)}]
)
def test_columns_have_as_many_rows_of_the_same_widths(odd):
    with pytest.raises(ValueError, match="columns do not fit one another"):
        columns(**odd)


BLOCKS = {"flux": np.ones((1, 3)), "emitter_id": np.zeros(1, np.int32)}
ROWS, COORDS, DENSITY = np.arange(N, dtype=np.int32), np.ones((N, 3)), np.ones(N)


@pytest.mark.parametrize(
    ("of_deposits", "odd"),
    [
        ((ROWS[1:], COORDS, DENSITY), {}),
        ((ROWS, COORDS[1:], DENSITY), {}),
        ((ROWS, COORDS[:, :2].copy(), DENSITY), {}),
        ((ROWS, COORDS, DENSITY[1:]), {}),
        *(((ROWS, COORDS, DENSITY), {"flux": np.ones(shape)}) for shape in ((1, 2), (2, 3))),
    ],
)
def test_deposits_want_a_row_coordinates_and_density_each_and_flux_of_blocks(of_deposits, odd):
    with pytest.raises(ValueError, match="do not fit the columns"):
        columns().write(np.zeros(N, DEPOSIT), *of_deposits, **BLOCKS | odd, first=0)


@pytest.mark.parametrize(("rows", "block"), [(ROWS - 1, 0), (ROWS + 1, 0), (ROWS, -1), (ROWS, 1)])
def test_deposits_want_rows_and_blocks_that_are_there(rows, block):
    deposits = np.zeros(N, DEPOSIT)
    deposits["block"] = block
    with pytest.raises(ValueError, match="rows and blocks of deposits should be below"):
        columns().write(deposits, rows, COORDS, DENSITY, **BLOCKS, first=0)


@pytest.mark.parametrize("first", [-1, 1])
def test_deposits_want_rows_of_the_columns(first):
    with pytest.raises(ValueError, match="should have rows"):
        columns().write(np.zeros(N, DEPOSIT), ROWS, COORDS, DENSITY, **BLOCKS, first=first)


@pytest.mark.parametrize(
    "odd", [{"origin": (N - 1, 3)}, {"direction": (N, 2)}, {"coords": (N, 1)}, {"density": N + 1}]
)
def test_emitted_rays_have_a_row_for_each_candidate(context, odd):
    shapes = {"origin": (N, 3), "direction": (N, 3), "coords": (N, 3), "density": N} | odd
    arrays = {name: np.empty(shape) for name, shape in shapes.items()}
    with pytest.raises(ValueError, match="do not fit one another"):
        emission_kernel.emit(context.emissions[0], np.arange(N), **arrays, n_threads=1)


@pytest.mark.parametrize(
    "odd", [{"origin": (15, 3)}, {"direction": (16, 2)}, {"pixel": 17}, {"film_change": (3, 3)}]
)
def test_camera_rays_have_a_row_each(context, odd):
    shapes = {"origin": (16, 3), "direction": (16, 3), "pixel": 16, "axis": 3}
    shapes |= {"origin_change": (2, 3), "film_change": (2, 3)} | odd
    given = {name: np.ones(shape) for name, shape in shapes.items()}
    given["pixel"] = given["pixel"].astype(np.int64)
    with pytest.raises(ValueError, match="do not fit one another"):
        camera_paths(context).start(**given)


def test_hits_of_camera_rays_are_those_of_its_live_rays(context):
    paths = camera_paths(context)
    found = context.caster.find(*(np.ones((3, 3), np.float32),) * 2)
    for process in (paths.advance, lambda hits: paths.first_surfaces(hits, np.ones(3), 1)):
        with pytest.raises(ValueError, match="found should be of 0 rays, but is of 3"):
            process(found)


def camera_paths(context):
    return hit_points.CameraPaths(
        *(context.materials, context.caster.frame, context.caster.triangles),
        least_weight=1e-3,
        longest_edge=1.0,
    )
