//! Masking and shadowing, with the cosines of the microfacet denominator cancelled: nothing is divided by a small number.

use crate::real::Lanes;

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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::brdf::testing::assert_slope;

    const COSINES: [f64; 5] = [1e-9, 1e-4, 0.1, 0.6, 1.0];
    const ALPHAS: [f64; 4] = [1e-6, 1e-3, 0.2, 1.0];

    #[test]
    fn schlick_is_the_quotient_of_the_literature() {
        let g = |cosine: f64, k: f64| cosine / (cosine * (1.0 - k) + k);
        for (v, l) in COSINES.into_iter().flat_map(|v| COSINES.map(|l| (v, l))) {
            for alpha in ALPHAS {
                let k = alpha / 2.0;
                let expected = g(v, k) * g(l, k) / (4.0 * v * l);
                assert!((visibility_schlick(v, l, k).value / expected - 1.0).abs() < 1e-12);
            }
        }
    }

    #[test]
    fn schlick_derivatives() {
        for (v, l) in COSINES.into_iter().flat_map(|v| COSINES.map(|l| (v, l))) {
            for k in ALPHAS.map(|alpha| alpha / 2.0) {
                let d = visibility_schlick(v, l, k);
                let value = |v: f64, l: f64, k: f64| visibility_schlick(v, l, k).value;
                let (v_width, l_width) = (v + k, l + k);
                assert_slope(|x| value(x, l, k).ln(), v, 1e-3 * v_width, d.d_n_dot_v, 1.0 / v_width);
                let k_width = k.min(v_width).min(l_width);
                assert_slope(|x| value(v, l, x).ln(), k, 1e-3 * k_width, d.d_k, 1.0 / k_width);
                let with_cosine = |x: f64| value(v, x, k) * x / d.value;
                assert_slope(with_cosine, l, 1e-3 * l_width, d.d_n_dot_l, 1.0);
            }
        }
    }

    #[test]
    fn smith_derivatives() {
        for (ax, ay) in ALPHAS.into_iter().flat_map(|ax| ALPHAS.map(|ay| (ax, ay))) {
            for cosine in COSINES {
                let sine = (1.0 - cosine * cosine).sqrt();
                let (alpha, direction) = ([ax, ay], [0.8 * sine, -0.6 * sine, cosine]);
                let d = masking_g1_smith_anisotropic(direction, alpha);
                let lambda = (ax * direction[0]).hypot(ay * direction[1]).hypot(cosine);
                assert!((d.value * (cosine + lambda) - 1.0).abs() < 1e-12);
                for i in 0..3 {
                    let at = |x: f64| {
                        let mut direction = direction;
                        direction[i] = x;
                        masking_g1_smith_anisotropic(direction, alpha).value
                    };
                    let length = if i < 2 { lambda / alpha[i] } else { lambda };
                    assert_slope(|x| at(x).ln(), direction[i], 1e-3 * length, d.d_direction[i], 1.0 / length);
                    if i == 2 {
                        assert_slope(|x| at(x) * x / d.value, cosine, 1e-3 * lambda, d.d_with_cosine, 1.0);
                    }
                }
                for i in 0..2 {
                    let at = |x: f64| {
                        let mut alpha = alpha;
                        alpha[i] = x.exp();
                        masking_g1_smith_anisotropic(direction, alpha).value.ln()
                    };
                    assert_slope(at, alpha[i].ln(), 1e-3, d.d_ln_alpha[i], 1.0);
                }
            }
        }
    }

    /// The bound on the reflected energy rests on this.
    #[test]
    fn schlick_masks_at_least_as_much_as_smith() {
        for alpha in ALPHAS {
            for i in 1..=1000 {
                let cosine = f64::from(i) / 1000.0;
                let sine = (1.0 - cosine * cosine).sqrt();
                let schlick = 1.0 / (cosine * (1.0 - alpha / 2.0) + alpha / 2.0);
                let smith = 2.0 * masking_g1_smith_anisotropic([sine, 0.0, cosine], [alpha; 2]).value;
                assert!(schlick <= smith * (1.0 + 1e-12), "{alpha} {cosine} {schlick} {smith}");
            }
        }
    }
}
