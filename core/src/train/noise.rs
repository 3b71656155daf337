//! Periodic Gaussian noise by the Fourier transform.

use std::f32::consts::FRAC_1_SQRT_2;
use std::sync::Arc;

use rustfft::algorithm::{BluesteinsAlgorithm, Radix4};
use rustfft::num_complex::Complex32;
use rustfft::{Fft, FftDirection};

use super::dice::Dice;

/// The shape of a noise's spectrum. Lengths are in pixels, frequencies in periods per pixel.
#[derive(Clone, Copy, Debug)]
pub(super) struct Spectrum {
    /// The amplitude falls with the frequency to this power.
    pub falloff: f32,
    /// Periods per texture below which there is nothing.
    pub coarse: f32,
    /// Periods per pixel above which there is nothing.
    pub fine: f32,
    /// By how much the noise is drawn out.
    pub stretch: f32,
    /// Along which direction, counter-clockwise from x, in radians.
    pub angle: f32,
}

impl Spectrum {
    pub fn new(falloff: f32, coarse: f32, fine: f32) -> Self {
        Self { falloff, coarse, fine, stretch: 1.0, angle: 0.0 }
    }

    pub fn stretched(self, stretch: f32, angle: f32) -> Self {
        Self { stretch, angle, ..self }
    }
}

/// The transform of textures of one size.
pub(super) struct Transform {
    side: usize,
    inverse: Arc<dyn Fft<f32>>,
}

impl Transform {
    pub fn new(side: usize) -> Self {
        // rustfft's planner would choose among all of its algorithms, and they take longer to compile than all of this crate.
        let inverse: Arc<dyn Fft<f32>> = if side.is_power_of_two() {
            Arc::new(Radix4::new(side, FftDirection::Inverse))
        } else {
            let inner = Radix4::new((2 * side).next_power_of_two(), FftDirection::Inverse);
            Arc::new(BluesteinsAlgorithm::new(side, Arc::new(inner)))
        };
        Self { side, inverse }
    }

    /// Pixels of a side.
    pub fn side(&self) -> usize {
        self.side
    }

    /// Noise with mean 0 and deviation 1.
    ///
    /// White noise has independent Gaussian values in the frequency domain too, so that only the way back is computed: of the half with
    /// frequencies of 0 and more in x, whose real part has the other half.
    pub fn noise(&self, dice: &mut Dice, spectrum: &Spectrum) -> Vec<f32> {
        let side = self.side;
        let low = spectrum.coarse / side as f32;
        let (sine, cosine) = spectrum.angle.sin_cos();
        let mut columns = vec![Complex32::default(); side * side];
        let half = columns.chunks_exact_mut(side).take(side / 2 + 1).enumerate();
        for (column, values) in half {
            let fx = column as f32 / side as f32;
            // These columns are their own other half.
            let share = if column == 0 || 2 * column == side { FRAC_1_SQRT_2 } else { 1.0 };
            for (row, value) in values.iter_mut().enumerate() {
                // y is upwards.
                let fy = -(if 2 * row < side { row as f32 } else { row as f32 - side as f32 }) / side as f32;
                let (along, across) = (cosine * fx + sine * fy, cosine * fy - sine * fx);
                let frequency = (along * spectrum.stretch).hypot(across);
                let [re, im] = dice.normals();
                if frequency > 0.0 {
                    let amplitude = share
                        * (frequency + low).powf(-spectrum.falloff)
                        * (-(frequency / spectrum.fine).powi(4)).exp()
                        * (1.0 - (-(frequency / low).powi(2)).exp());
                    *value = Complex32::new(re * amplitude, im * amplitude);
                }
            }
        }
        self.inverse.process(&mut columns);
        let mut rows = vec![Complex32::default(); side * side];
        for (row, values) in rows.chunks_exact_mut(side).enumerate() {
            for (value, column) in values.iter_mut().zip(columns.chunks_exact(side)) {
                *value = column[row];
            }
        }
        self.inverse.process(&mut rows);
        let power: f64 = rows.iter().map(|value| f64::from(value.re * value.re)).sum();
        let scale = 1.0 / ((power / rows.len() as f64).sqrt() as f32).max(1e-6);
        rows.into_iter().map(|value| value.re * scale).collect()
    }
}

#[cfg(test)]
mod tests {
    use rustfft::algorithm::Dft;
    use rustfft::num_complex::Complex32;
    use rustfft::{Fft, FftDirection};

    use super::super::dice::{Dice, Purpose};
    use super::{Spectrum, Transform};

    #[test]
    fn transforms_of_all_sizes_are_those_of_the_definition() {
        for side in [8, 9, 24, 31, 64, 100, 128] {
            let mut dice = Dice::new(1, Purpose::Procedural, [0, 0]);
            let values: Vec<_> = (0..side).map(|_| dice.normals()).map(|[re, im]| Complex32::new(re, im)).collect();
            let (mut fast, mut slow) = (values.clone(), values);
            Transform::new(side).inverse.process(&mut fast);
            Dft::new(side, FftDirection::Inverse).process(&mut slow);
            for (fast, slow) in fast.into_iter().zip(slow) {
                assert!((fast - slow).norm() < 1e-4, "{side}: {fast} {slow}");
            }
        }
    }

    /// Root mean square of the differences between neighbours, to the right and downwards.
    fn roughness(field: &[f32], side: usize) -> [f64; 2] {
        [(1, 0), (0, 1)].map(|(right, down)| {
            let square = |at: usize| {
                let other = (at / side + down) % side * side + (at % side + right) % side;
                f64::from(field[at] - field[other]).powi(2)
            };
            ((0..field.len()).map(square).sum::<f64>() / field.len() as f64).sqrt()
        })
    }

    #[test]
    fn moments_and_smoothness() {
        // Means over 2000 fields of 64 x 64 made by filtering white noise with PyTorch's transforms.
        for (spectrum, expected) in [
            (Spectrum::new(1.3, 2.0, 0.5), [0.6929, 0.6928]),
            (Spectrum::new(1.5, 4.0, 0.1), [0.3108, 0.3109]),
            (Spectrum::new(0.4, 2.0, 0.5).stretched(20.0, 0.3), [0.3621, 1.0154]),
        ] {
            let transform = Transform::new(64);
            let mut dice = Dice::new(5, Purpose::Procedural, [0, 0]);
            let mut means = [0.0; 2];
            for _ in 0..200 {
                let field = transform.noise(&mut dice, &spectrum);
                let mean = field.iter().sum::<f32>() / field.len() as f32;
                assert!(mean.abs() < 1e-3, "{mean}");
                let rough = roughness(&field, 64);
                means = [means[0] + rough[0] / 200.0, means[1] + rough[1] / 200.0];
            }
            for (mean, expected) in means.into_iter().zip(expected) {
                assert!((mean / expected - 1.0).abs() < 0.02, "{means:?} {expected:?}");
            }
        }
    }
}
