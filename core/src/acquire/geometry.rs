//! Maps between planes.
#![allow(clippy::needless_range_loop, reason = "the indices are those of the textbook")]

/// A map from one plane to another that keeps lines straight.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Homography(pub [[f64; 3]; 3]);

impl Homography {
    /// The map that takes the first point of each pair nearest to the second; `None` if the points leave it open.
    ///
    /// # Source
    /// Hartley, "In Defense of the Eight-Point Algorithm", PAMI 1997, for the normalisation.
    pub fn between(pairs: &[([f64; 2], [f64; 2])]) -> Option<Self> {
        if pairs.len() < 4 {
            return None;
        }
        let (from, to) =
            (Normalisation::of(pairs.iter().map(|pair| pair.0)), Normalisation::of(pairs.iter().map(|pair| pair.1)));
        let (mut matrix, mut right) = ([[0.0; 8]; 8], [0.0; 8]);
        for &(a, b) in pairs {
            let ([x, y], [u, v]) = (from.apply(a), to.apply(b));
            let rows =
                [([x, y, 1.0, 0.0, 0.0, 0.0, -u * x, -u * y], u), ([0.0, 0.0, 0.0, x, y, 1.0, -v * x, -v * y], v)];
            for (row, value) in rows {
                for i in 0..8 {
                    right[i] += row[i] * value;
                    for j in 0..8 {
                        matrix[i][j] += row[i] * row[j];
                    }
                }
            }
        }
        let [a, b, c, d, e, f, g, h] = solve(matrix, right)?;
        let normalised = Self([[a, b, c], [d, e, f], [g, h, 1.0]]);
        Some(Self(product(to.inverse(), product(normalised.0, from.matrix()))))
    }

    /// Where a point is taken; not finite on the line that has no image.
    pub fn apply(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        let [u, v, w] = self.0.map(|[a, b, c]| a * x + b * y + c);
        [u / w, v / w]
    }
}

/// Moves the mean of points to the origin and their mean distance from it to the square root of two.
struct Normalisation {
    mean: [f64; 2],
    scale: f64,
}

impl Normalisation {
    fn of(points: impl Iterator<Item = [f64; 2]> + Clone) -> Self {
        let count = points.clone().count() as f64;
        let sum = points.clone().fold([0.0; 2], |sum, point| [sum[0] + point[0], sum[1] + point[1]]);
        let mean = sum.map(|sum| sum / count);
        let far = points.map(|[x, y]| (x - mean[0]).hypot(y - mean[1])).sum::<f64>() / count;
        Self { mean, scale: if far > 0.0 { std::f64::consts::SQRT_2 / far } else { 1.0 } }
    }

    fn apply(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        [(x - self.mean[0]) * self.scale, (y - self.mean[1]) * self.scale]
    }

    fn matrix(&self) -> [[f64; 3]; 3] {
        let Self { mean: [x, y], scale } = *self;
        [[scale, 0.0, -scale * x], [0.0, scale, -scale * y], [0.0, 0.0, 1.0]]
    }

    fn inverse(&self) -> [[f64; 3]; 3] {
        let Self { mean: [x, y], scale } = *self;
        [[1.0 / scale, 0.0, x], [0.0, 1.0 / scale, y], [0.0, 0.0, 1.0]]
    }
}

pub fn product(a: [[f64; 3]; 3], b: [[f64; 3]; 3]) -> [[f64; 3]; 3] {
    a.map(|row| std::array::from_fn(|j| (0..3).map(|k| row[k] * b[k][j]).sum()))
}

pub fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

pub fn norm(a: [f64; 3]) -> f64 {
    a.iter().map(|x| x * x).sum::<f64>().sqrt()
}

/// The solution of a linear system, by elimination with pivots; `None` if it has none or many.
fn solve<const N: usize>(mut matrix: [[f64; N]; N], mut right: [f64; N]) -> Option<[f64; N]> {
    for column in 0..N {
        let size = |row: &usize| matrix[*row][column].abs();
        let pivot = (column..N).max_by(|a, b| size(a).total_cmp(&size(b)))?;
        // Not a number neither.
        if size(&pivot).is_nan() || size(&pivot) <= 1e-12 {
            return None;
        }
        matrix.swap(column, pivot);
        right.swap(column, pivot);
        for row in column + 1..N {
            let factor = matrix[row][column] / matrix[column][column];
            for k in column..N {
                matrix[row][k] -= factor * matrix[column][k];
            }
            right[row] -= factor * right[column];
        }
    }
    for row in (0..N).rev() {
        let known: f64 = (row + 1..N).map(|k| matrix[row][k] * right[k]).sum();
        right[row] = (right[row] - known) / matrix[row][row];
    }
    Some(right)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_map_is_found_from_what_it_does() {
        let map = Homography([[3.0, 0.2, 100.0], [-0.3, 2.5, 40.0], [0.001, -0.002, 1.0]]);
        let points = [[-50.0, -40.0], [60.0, -45.0], [55.0, 70.0], [-48.0, 66.0], [3.0, 8.0]];
        for count in [4, 5] {
            let pairs: Vec<_> = points[..count].iter().map(|&point| (point, map.apply(point))).collect();
            let found = Homography::between(&pairs).unwrap();
            for point in [[0.0, 0.0], [30.0, -70.0]] {
                let (found, known) = (found.apply(point), map.apply(point));
                assert!((found[0] - known[0]).abs() < 1e-8 && (found[1] - known[1]).abs() < 1e-8);
            }
        }
    }

    #[test]
    fn points_on_a_line_leave_it_open() {
        let pairs: Vec<_> = (0..6).map(|i| ([f64::from(i), 2.0 * f64::from(i)], [f64::from(i), 0.0])).collect();
        assert_eq!(Homography::between(&pairs), None);
        assert_eq!(Homography::between(&pairs[..3]), None);
        let same = vec![([1.0, 1.0], [2.0, 2.0]); 5];
        assert_eq!(Homography::between(&same), None);
    }
}
