//! Small symmetric systems.
#![allow(clippy::needless_range_loop, reason = "the indices are those of the textbook")]

use crate::real::Lanes;

/// The Cholesky factors of symmetric positive definite matrices, one for each lane.
#[derive(Clone, Copy, Debug)]
pub struct Cholesky<L, const N: usize> {
    /// Lower triangle, the diagonal inverted.
    factor: [[L; N]; N],
}

impl<const N: usize> Cholesky<f64, N> {
    /// The factor of a single `matrix`; `None` if it is not positive definite.
    pub fn of(matrix: &[[f64; N]; N]) -> Option<Self> {
        let (factor, definite) = Self::new(matrix);
        definite.then_some(factor)
    }
}

impl<L: Lanes, const N: usize> Cholesky<L, N> {
    /// Factors `matrix`, of which the lower triangle is read. Also where it is positive definite; elsewhere the factor means nothing.
    #[inline(always)]
    pub fn new(matrix: &[[L; N]; N]) -> (Self, L::Mask) {
        let (zero, one, largest) = (L::splat(0.0), L::splat(1.0), L::splat(L::NORMAL_RANGE[1]));
        let mut factor = [[zero; N]; N];
        let mut definite = one.gt(zero);
        for i in 0..N {
            for j in 0..=i {
                let mut sum = matrix[i][j];
                for k in 0..j {
                    sum = sum - factor[i][k] * factor[j][k];
                }
                if i > j {
                    factor[i][j] = sum * factor[j][j];
                } else {
                    let usable = sum.gt(zero) & largest.ge(sum);
                    definite = definite & usable;
                    factor[i][i] = one / L::select(usable, sum, one).sqrt();
                }
            }
        }
        (Self { factor }, definite)
    }

    /// `L^-1 b`, where the matrix is `L L^T`.
    #[inline(always)]
    fn forward(&self, mut b: [L; N]) -> [L; N] {
        for i in 0..N {
            for k in 0..i {
                b[i] = b[i] - self.factor[i][k] * b[k];
            }
            b[i] = b[i] * self.factor[i][i];
        }
        b
    }

    /// The solution of the system with the right-hand side `b`.
    #[inline(always)]
    pub fn solve(&self, b: [L; N]) -> [L; N] {
        let mut x = self.forward(b);
        for i in (0..N).rev() {
            for k in i + 1..N {
                x[i] = x[i] - self.factor[k][i] * x[k];
            }
            x[i] = x[i] * self.factor[i][i];
        }
        x
    }

    /// The diagonal of the inverse.
    #[inline(always)]
    pub fn inverse_diagonal(&self) -> [L; N] {
        let mut diagonal = [L::splat(0.0); N];
        for i in 0..N {
            let mut unit = [L::splat(0.0); N];
            unit[i] = L::splat(1.0);
            for value in self.forward(unit) {
                diagonal[i] = value.mul_add(value, diagonal[i]);
            }
        }
        diagonal
    }
}

#[cfg(test)]
mod tests {
    use super::Cholesky;

    const MATRIX: [[f64; 3]; 3] = [[4.0, 2.0, 0.6], [2.0, 5.0, 1.5], [0.6, 1.5, 3.8]];

    fn times(x: [f64; 3]) -> [f64; 3] {
        MATRIX.map(|row| row.iter().zip(x).map(|(a, x)| a * x).sum())
    }

    #[test]
    fn solutions() {
        let x = [0.3, -1.2, 2.5];
        let solved = Cholesky::new(&MATRIX).0.solve(times(x));
        for i in 0..3 {
            assert!((solved[i] - x[i]).abs() < 1e-12);
        }
    }

    #[test]
    fn inverses() {
        let (cholesky, definite) = Cholesky::new(&MATRIX);
        assert!(definite);
        for (i, diagonal) in cholesky.inverse_diagonal().into_iter().enumerate() {
            let mut unit = [0.0; 3];
            unit[i] = 1.0;
            assert!((cholesky.solve(unit)[i] - diagonal).abs() < 1e-14);
        }
    }

    #[test]
    fn the_indefinite_is_told() {
        assert!(Cholesky::of(&[[1.0, 0.0], [2.0, 1.0]]).is_none());
        assert!(Cholesky::of(&[[f64::NAN]]).is_none());
    }
}
