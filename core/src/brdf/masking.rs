//! Masking and shadowing, with the cosines of the microfacet denominator cancelled: nothing is divided by a small number.

use super::real::Lanes;

/// `G / (4 (n.v) (n.l))` with its derivatives.
#[derive(Clone, Copy, Debug)]
pub struct Visibility<L> {
    /// The value; at most `1 / (4 k^2)`.
    pub value: L,
    /// (value + n.l d value / d n.l) / value: what a factor n.l outside leaves of the derivative.
    pub d_n_dot_l: L,
    /// d ln value / d n.v.
    pub d_n_dot_v: L,
    /// d ln value / d k.
    pub d_k: L,
}

/// Masking and shadowing of Schlick's form, `g(n.v) g(n.l)` with `g(c) = c / (c (1 - k) + k)`, over `4 (n.v) (n.l)`.
///
/// `n_dot_v`, `n_dot_l` in [0, 1]; `k` = alpha / 2.
///
/// # Source
/// Schlick, "An Inexpensive BRDF Model for Physically-based Rendering", Eurographics 1994; k as in Karis, "Real Shading in Unreal Engine 4", 2013.
#[inline(always)]
pub fn visibility_schlick<L: Lanes>(n_dot_v: L, n_dot_l: L, k: L) -> Visibility<L> {
    let one = L::splat(1.0);
    let rest = one - k;
    let inverse_v = one / n_dot_v.mul_add(rest, k);
    let inverse_l = one / n_dot_l.mul_add(rest, k);
    Visibility {
        value: L::splat(0.25) * inverse_v * inverse_l,
        d_n_dot_l: k * inverse_l,
        d_n_dot_v: -rest * inverse_v,
        d_k: -((one - n_dot_v) * inverse_v + (one - n_dot_l) * inverse_l),
    }
}

/// One direction's part of the anisotropic Smith term: `1 / (n.u + lambda)` with `lambda = sqrt((ax u.t)^2 + (ay u.b)^2 + (n.u)^2)`.
#[derive(Clone, Copy, Debug)]
pub struct SmithAnisotropic<L> {
    /// `1 / (n.u + lambda)` = G1(u) / (2 n.u).
    pub value: L,
    /// d ln value / d u, in the frame (tangent, bitangent, normal).
    pub d_direction: [L; 3],
    /// (value + n.u d value / d n.u) / value: what a factor n.u outside leaves of the derivative.
    pub d_with_cosine: L,
    /// d ln value / d ln alpha, for x and y.
    pub d_ln_alpha: [L; 2],
}

/// Smith's masking of one direction for anisotropic GGX, divided by twice the cosine. The separable (height-uncorrelated)
/// `G / (4 (n.v) (n.l))` is the product of two.
///
/// `direction` is a unit vector in the frame (tangent, bitangent, normal) with a cosine above 0; `alpha` = (ax, ay).
///
/// # Source
/// Heitz, "Understanding the Masking-Shadowing Function in Microfacet-Based BRDFs", JCGT 2014, eqs. 72 and 86.
#[inline(always)]
pub fn masking_g1_smith_anisotropic<L: Lanes>(direction: [L; 3], alpha: [L; 2]) -> SmithAnisotropic<L> {
    let one = L::splat(1.0);
    let (x, y, cosine) = (alpha[0] * direction[0], alpha[1] * direction[1], direction[2]);
    let excess = x.mul_add(x, y * y);
    let lambda = cosine.mul_add(cosine, excess).sqrt();
    let inverse_lambda = one / lambda;
    let value = one / (cosine + lambda);
    let slope = -value * inverse_lambda;
    SmithAnisotropic {
        value,
        d_direction: [slope * x * alpha[0], slope * y * alpha[1], -inverse_lambda],
        // (lambda - cosine) / lambda, without the subtraction.
        d_with_cosine: excess * value * inverse_lambda,
        d_ln_alpha: [slope * x * x, slope * y * y],
    }
}
