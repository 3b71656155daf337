//! Microfacet normal distributions.

use crate::real::Lanes;

/// Smallest alpha the model renders, [`super::ROUGHNESS_MIN`] squared.
pub const ALPHA_MIN: f64 = 1e-6;

/// Value of the isotropic GGX distribution with its logarithmic derivatives.
#[derive(Clone, Copy, Debug)]
pub struct Ggx<L> {
    /// D in 1/sr.
    pub value: L,
    /// d ln D / d |n x h|^2.
    pub d_sin2: L,
    /// d ln D / d ln alpha, in [-2, 2].
    pub d_ln_alpha: L,
}

/// GGX normal distribution function D(h), isotropic.
///
/// `sin2` = |n x h|^2 in [0, 1] for unit vectors; `alpha` in [[`ALPHA_MIN`], 1].
///
/// # Source
/// Walter et al., "Microfacet Models for Refraction through Rough Surfaces", EGSR 2007, eq. 33.
/// # Differences
/// Takes |n x h|^2 instead of 1 - (n.h)^2, which cancels for mirror-like alpha even in double precision.
#[inline(always)]
pub fn ndf_ggx<L: Lanes>(sin2: L, alpha: L) -> Ggx<L> {
    let one = L::splat(1.0);
    let alpha2 = alpha * alpha;
    let tail = (one - alpha) * (one + alpha);
    // (n.h)^2 (alpha^2 - 1) + 1 with (n.h)^2 = 1 - sin2: two terms that are not negative.
    let inverse = one / sin2.mul_add(tail, alpha2);
    let ratio = alpha * inverse;
    Ggx {
        value: ratio * ratio * L::splat(std::f64::consts::FRAC_1_PI),
        d_sin2: L::splat(-2.0) * tail * inverse,
        d_ln_alpha: L::splat(2.0) * (sin2 - alpha2 * (one - sin2)) * inverse,
    }
}

/// Value of the anisotropic GGX distribution with its logarithmic derivatives.
#[derive(Clone, Copy, Debug)]
pub struct GgxAnisotropic<L> {
    /// D in 1/sr.
    pub value: L,
    /// d ln D / d h, in the frame (tangent, bitangent, normal).
    pub d_half: [L; 3],
    /// d ln D / d ln alpha, for x and y.
    pub d_ln_alpha: [L; 2],
}

/// GGX normal distribution function D(h), anisotropic: `1 / (pi ax ay ((h.t/ax)^2 + (h.b/ay)^2 + (h.n)^2)^2)`.
///
/// `half` is the half vector in the frame (tangent, bitangent, normal), `alpha` = (ax, ay), each in [[`ALPHA_MIN`], 1].
///
/// # Source
/// Burley, "Physically Based Shading at Disney", 2012, appendix B.2; Heitz, "Understanding the Masking-Shadowing Function", JCGT 2014, eq. 85.
#[inline(always)]
pub fn ndf_ggx_anisotropic<L: Lanes>(half: [L; 3], alpha: [L; 2]) -> GgxAnisotropic<L> {
    let one = L::splat(1.0);
    let inverse_alpha = [one / alpha[0], one / alpha[1]];
    let (x, y) = (half[0] * inverse_alpha[0], half[1] * inverse_alpha[1]);
    let inverse = one / x.mul_add(x, y.mul_add(y, half[2] * half[2]));
    let slope = L::splat(-4.0) * inverse;
    let four = L::splat(4.0);
    GgxAnisotropic {
        value: L::splat(std::f64::consts::FRAC_1_PI) * (inverse_alpha[0] * inverse) * (inverse_alpha[1] * inverse),
        d_half: [slope * x * inverse_alpha[0], slope * y * inverse_alpha[1], slope * half[2]],
        d_ln_alpha: [(four * x * x).mul_add(inverse, -one), (four * y * y).mul_add(inverse, -one)],
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::brdf::testing::assert_slope;
    use std::f64::consts::{FRAC_PI_2, TAU};

    const ALPHAS: [f64; 5] = [ALPHA_MIN, 1e-3, 0.1, 0.5, 1.0];

    /// A half vector `widths` lobe widths from the normal, in the frame (tangent, bitangent, normal).
    fn half_vector(widths: f64, alpha: [f64; 2], azimuth: f64) -> [f64; 3] {
        let (x, y) = (widths * alpha[0] * azimuth.cos(), widths * alpha[1] * azimuth.sin());
        [x, y, 1.0].map(|component| component / (1.0 + x * x + y * y).sqrt())
    }

    #[test]
    fn isotropic_derivatives() {
        for alpha in ALPHAS {
            for sin2 in [0.0, 1e-13, 1e-6 * alpha * alpha, alpha * alpha, 0.3, 1.0] {
                let d = ndf_ggx(sin2, alpha);
                let width = alpha * alpha + sin2;
                assert_slope(|x| ndf_ggx(x, alpha).value.ln(), sin2, 1e-3 * width, d.d_sin2, 1.0 / width);
                assert_slope(|x| ndf_ggx(sin2, x.exp()).value.ln(), alpha.ln(), 1e-3, d.d_ln_alpha, 1.0);
            }
        }
    }

    #[test]
    fn isotropic_is_anisotropic_with_equal_widths() {
        for alpha in ALPHAS {
            for widths in [0.0, 0.5, 3.0] {
                let half = half_vector(widths, [alpha; 2], 0.7);
                let one = ndf_ggx(half[0] * half[0] + half[1] * half[1], alpha);
                let both = ndf_ggx_anisotropic(half, [alpha; 2]);
                assert!((one.value / both.value - 1.0).abs() < 1e-12);
                assert!((one.d_ln_alpha - both.d_ln_alpha[0] - both.d_ln_alpha[1]).abs() < 1e-12);
            }
        }
    }

    #[test]
    fn anisotropic_derivatives() {
        for (ax, ay) in ALPHAS.into_iter().flat_map(|ax| ALPHAS.map(|ay| (ax, ay))) {
            for widths in [0.0, 0.5, 3.0] {
                let (half, alpha) = (half_vector(widths, [ax, ay], 0.7), [ax, ay]);
                let d = ndf_ggx_anisotropic(half, alpha);
                for i in 0..3 {
                    let at = |x: f64| {
                        let mut half = half;
                        half[i] = x;
                        ndf_ggx_anisotropic(half, alpha).value.ln()
                    };
                    let length = if i < 2 { alpha[i] } else { 1.0 };
                    assert_slope(at, half[i], 1e-3 * length, d.d_half[i], 1.0 / length);
                }
                for i in 0..2 {
                    let at = |x: f64| {
                        let mut alpha = alpha;
                        alpha[i] = x.exp();
                        ndf_ggx_anisotropic(half, alpha).value.ln()
                    };
                    assert_slope(at, alpha[i].ln(), 1e-3, d.d_ln_alpha[i], 1.0);
                }
            }
        }
    }

    /// The visible area of all microfacets is the area of the surface: D (n.h) integrates to 1.
    #[test]
    fn the_distribution_is_normalised() {
        for alpha in [[0.05, 0.05], [0.3, 0.3], [1.0, 1.0], [0.1, 0.7]] {
            let (rings, sectors) = (4000, 200);
            let mut sum = 0.0;
            for ring in 0..rings {
                // Rings are narrow near the normal, where the lobe is.
                let t = (f64::from(ring) + 0.5) / f64::from(rings);
                let theta = FRAC_PI_2 * t * t * t;
                let area = theta.sin() * FRAC_PI_2 * 3.0 * t * t / f64::from(rings) * TAU / f64::from(sectors);
                for sector in 0..sectors {
                    let phi = TAU * (f64::from(sector) + 0.5) / f64::from(sectors);
                    let half = [theta.sin() * phi.cos(), theta.sin() * phi.sin(), theta.cos()];
                    sum += ndf_ggx_anisotropic(half, alpha).value * half[2] * area;
                }
            }
            assert!((sum - 1.0).abs() < 1e-3, "{alpha:?} {sum}");
        }
    }
}
