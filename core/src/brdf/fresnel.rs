//! Fresnel reflectance.

use crate::real::Lanes;

/// Weight of white in the spherical Gaussian approximation of Schlick's term: `F = F0 + (1 - F0) * weight`.
///
/// `v_dot_h` in [0, 1] is the cosine between view direction and half vector; the weight lies in [1.7e-4, 1].
/// It does not depend on the maps, so it has no gradient here.
///
/// # Source
/// Lagarde, "Spherical Gaussian approximation for Blinn-Phong, Phong and Fresnel", 2012; Karis, "Real Shading in Unreal Engine 4", 2013.
/// # Differences
/// Not Schlick's own `(1 - v_dot_h)^5`: at `v_dot_h = 1` it leaves 1.7e-4 instead of 0.
#[inline(always)]
pub fn fresnel_spherical_gaussian_weight<L: Lanes>(v_dot_h: L) -> L {
    (v_dot_h.mul_add(L::splat(-5.554_73), L::splat(-6.983_16)) * v_dot_h).exp2()
}

#[cfg(test)]
mod tests {
    use super::fresnel_spherical_gaussian_weight;

    #[test]
    fn stays_near_schlick() {
        assert_eq!(fresnel_spherical_gaussian_weight(0.0_f64), 1.0);
        assert!((fresnel_spherical_gaussian_weight(1.0_f64) - 1.6816e-4).abs() < 1e-8);
        for i in 0..=1000 {
            let cosine = f64::from(i) / 1000.0;
            let schlick = (1.0 - cosine).powi(5);
            assert!((fresnel_spherical_gaussian_weight(cosine) - schlick).abs() < 0.014);
        }
    }
}
