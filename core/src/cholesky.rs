//! Small symmetric systems.
#![allow(clippy::needless_range_loop, reason = "the indices are those of the textbook")]

/// The Cholesky factor of a symmetric positive definite matrix.
#[derive(Clone, Copy, Debug)]
pub struct Cholesky<const N: usize> {
    /// Lower triangle, the diagonal inverted.
    factor: [[f64; N]; N],
}

impl<const N: usize> Cholesky<N> {
    /// Factors `matrix`, of which the lower triangle is read; `None` if it is not positive definite.
    pub fn new(matrix: &[[f64; N]; N]) -> Option<Self> {
        let mut factor = [[0.0; N]; N];
        for i in 0..N {
            for j in 0..=i {
                let mut sum = matrix[i][j];
                for k in 0..j {
                    sum -= factor[i][k] * factor[j][k];
                }
                if i > j {
                    factor[i][j] = sum * factor[j][j];
                } else if sum > 0.0 && sum.is_finite() {
                    factor[i][i] = 1.0 / sum.sqrt();
                } else {
                    return None;
                }
            }
        }
        Some(Self { factor })
    }

    /// `L^-1 b`, where the matrix is `L L^T`.
    fn forward(&self, mut b: [f64; N]) -> [f64; N] {
        for i in 0..N {
            for k in 0..i {
                b[i] -= self.factor[i][k] * b[k];
            }
            b[i] *= self.factor[i][i];
        }
        b
    }

    /// The solution of the system with the right-hand side `b`.
    pub fn solve(&self, b: [f64; N]) -> [f64; N] {
        let mut x = self.forward(b);
        for i in (0..N).rev() {
            for k in i + 1..N {
                x[i] -= self.factor[k][i] * x[k];
            }
            x[i] *= self.factor[i][i];
        }
        x
    }

    /// The diagonal of the inverse.
    pub fn inverse_diagonal(&self) -> [f64; N] {
        std::array::from_fn(|i| {
            let mut unit = [0.0; N];
            unit[i] = 1.0;
            self.forward(unit).iter().map(|value| value * value).sum()
        })
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
        let solved = Cholesky::new(&MATRIX).unwrap().solve(times(x));
        for i in 0..3 {
            assert!((solved[i] - x[i]).abs() < 1e-12);
        }
    }

    #[test]
    fn inverses() {
        let cholesky = Cholesky::new(&MATRIX).unwrap();
        for (i, diagonal) in cholesky.inverse_diagonal().into_iter().enumerate() {
            let mut unit = [0.0; 3];
            unit[i] = 1.0;
            assert!((cholesky.solve(unit)[i] - diagonal).abs() < 1e-14);
        }
    }

    #[test]
    fn indefinite_is_no_solution() {
        assert!(Cholesky::new(&[[1.0, 0.0], [2.0, 1.0]]).is_none());
    }
}
