//! Microfacet normal distributions.

use super::real::Lanes;

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
