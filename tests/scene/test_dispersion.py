"""Indices over wavelength by catalogues of glass, colours by white light."""

import numpy as np
import pytest

import photonrelax as pr
from photonrelax.scene.digest import scene_digest
from photonrelax.scene.dispersion import (
    C_LINE,
    D_LINE,
    F_LINE,
    LONGEST,
    SHORTEST,
    colour_matching,
    colour_table,
    table_wavelengths,
)

# Schott's catalogue: n_d, n_F, n_C and V_d of N-BK7.
BK7 = (1.51680, 1.52238, 1.51432, 64.17)
SCHOTT = pr.Sellmeier(
    (1.03961212, 0.231792344, 1.01046945), (0.00600069867, 0.0200179144, 103.560653)
)
FORMULAS = [SCHOTT, pr.Abbe(BK7[0], BK7[3]), pr.Cauchy(1.5046, 0.0042)]


@pytest.mark.parametrize(("glass", "tolerance"), [*zip(FORMULAS, (2e-5, 1e-4, 5e-4), strict=True)])
def test_indices_are_those_of_the_catalogue(glass, tolerance):
    np.testing.assert_allclose(glass.index([D_LINE, F_LINE, C_LINE]), BK7[:3], atol=tolerance)
    assert glass.index_d == glass.index(D_LINE)
    assert pr.Dielectric(glass).row().ior == glass.index_d


def test_abbe_numbers_are_held_exactly():
    assert SCHOTT.abbe_number == pytest.approx(BK7[3], abs=0.01)
    assert pr.Abbe(1.7, 30.0).abbe_number == pytest.approx(30.0, rel=1e-12)
    assert pr.Abbe(1.7, 30.0).index_d == pytest.approx(1.7, rel=1e-15)
    assert pr.Cauchy(1.5, 0.0).abbe_number == np.inf


def test_an_index_is_validated():
    with pytest.raises(ValueError, match="positive indices from 380 to 720 nm, but has -"):
        pr.Cauchy(1.5, -4200.0)
    with pytest.raises(ValueError, match="nan at"):
        pr.Sellmeier((1.0,), (0.25,))
    with pytest.raises(ValueError, match="c should have shape"):
        pr.Sellmeier((1.0, 2.0), (0.01,))
    with pytest.raises(ValueError, match="v_d"):
        pr.Abbe(1.5, 0.0)


def test_white_light_is_white():
    """Of the same power at all wavelengths, in the mean of the interpolated table."""
    fine = np.linspace(SHORTEST, LONGEST, 200_001)
    colours = [np.interp(fine, table_wavelengths(), column) for column in colour_table().T]
    np.testing.assert_allclose(np.mean(colours, axis=1), 1.0, atol=1e-5)


def test_colours_are_those_of_the_observer_of_1931():
    """The CIE's tables of ȳ peak at 555 nm, and hold x̄, ȳ, z̄ at these wavelengths."""
    tables = {
        450: (0.3362, 0.0380, 1.7721),
        555: (0.5121, 1.0, 0.0057),
        610: (1.0026, 0.503, 0.0003),
    }
    np.testing.assert_allclose(colour_matching(list(tables)), list(tables.values()), atol=0.03)
    red, green, blue = (
        colour_table()[np.abs(table_wavelengths() - w).argmin()] for w in (620, 530, 450)
    )
    assert [red.argmax(), green.argmax(), blue.argmax()] == [0, 1, 2]
    # Outside of sRGB.
    assert green[0] < 0.0


def test_a_digest_tells_dispersions_apart():
    import trimesh

    def digest(ior):
        ball = trimesh.creation.icosphere(subdivisions=1)
        return scene_digest(
            pr.Scene([pr.SceneObject(ball, pr.Dielectric(ior))], [pr.PointEmitter((0, 0, 3))])
        )

    digests = [digest(ior) for ior in (1.5, *FORMULAS, pr.Cauchy(1.5046, 0.0043))]
    assert len(set(digests)) == len(digests)
    assert digest(pr.Cauchy(1.5, 0.004)) == digest(pr.Cauchy(1.5, 0.004))
