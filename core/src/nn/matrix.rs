//! Matrix products.
#![allow(unsafe_code)]

use rayon::prelude::*;

use super::scalar::Scalar;

/// Rows of a product that one task computes.
const TASK_ROWS: usize = 256;

/// A matrix that borrows its values.
#[derive(Clone, Copy)]
pub(crate) struct Matrix<'a, E> {
    data: &'a [E],
    rows: usize,
    columns: usize,
    row_stride: usize,
    column_stride: usize,
}

impl<'a, E> Matrix<'a, E> {
    /// A matrix stored row after row.
    pub fn new(data: &'a [E], rows: usize, columns: usize) -> Self {
        assert_eq!(data.len(), rows * columns, "a matrix of {rows} x {columns}");
        Self { data, rows, columns, row_stride: columns, column_stride: 1 }
    }

    /// Its transpose.
    pub fn transposed(self) -> Self {
        Self {
            rows: self.columns,
            columns: self.rows,
            row_stride: self.column_stride,
            column_stride: self.row_stride,
            ..self
        }
    }

    /// Rows `start..start + rows`.
    fn slice_rows(self, start: usize, rows: usize) -> Self {
        assert!(start + rows <= self.rows);
        Self { data: &self.data[start * self.row_stride..], rows, ..self }
    }
}

/// `out = a b`, or `out += a b`; `out` lies row after row.
pub(crate) fn multiply<E: Scalar>(out: &mut [E], accumulate: bool, a: Matrix<'_, E>, b: Matrix<'_, E>) {
    assert_eq!(a.columns, b.rows, "inner dimensions of a product");
    assert_eq!(out.len(), a.rows * b.columns, "size of a product");
    if out.is_empty() {
        return;
    }
    if a.columns == 0 {
        if !accumulate {
            out.fill(E::default());
        }
        return;
    }
    out.par_chunks_mut(TASK_ROWS * b.columns).enumerate().for_each(|(task, out)| {
        let a = a.slice_rows(task * TASK_ROWS, out.len() / b.columns);
        for m in [a, b] {
            assert!((m.rows - 1) * m.row_stride + (m.columns - 1) * m.column_stride < m.data.len());
        }
        // SAFETY: `out` holds a.rows x b.columns values with row stride b.columns and nobody else has it; the last elements of
        // `a` and `b`, and with them all, lie inside their slices, as just asserted; E is f32 or f64, which the function handles.
        unsafe {
            gemm::gemm(
                a.rows,
                b.columns,
                a.columns,
                out.as_mut_ptr(),
                1,
                b.columns as isize,
                accumulate,
                a.data.as_ptr(),
                a.column_stride as isize,
                a.row_stride as isize,
                b.data.as_ptr(),
                b.column_stride as isize,
                b.row_stride as isize,
                E::ONE,
                E::ONE,
                false,
                false,
                false,
                gemm::Parallelism::None,
            );
        }
    });
}

#[cfg(test)]
mod tests {
    use super::{Matrix, multiply};

    fn plain(a: &[f64], b: &[f64], (m, k, n): (usize, usize, usize)) -> Vec<f64> {
        (0..m * n).map(|i| (0..k).map(|l| a[i / n * k + l] * b[l * n + i % n]).sum()).collect()
    }

    fn transpose(data: &[f64], rows: usize, columns: usize) -> Vec<f64> {
        (0..rows * columns).map(|i| data[i % rows * columns + i / rows]).collect()
    }

    #[test]
    fn products_of_all_orientations() {
        for (m, k, n) in [(1, 1, 1), (3, 5, 7), (600, 17, 33), (257, 4, 1), (2, 0, 3)] {
            let a: Vec<f64> = (0..m * k).map(|i| (i as f64 * 0.37).sin()).collect();
            let b: Vec<f64> = (0..k * n).map(|i| (i as f64 * 0.91).cos()).collect();
            let expected = plain(&a, &b, (m, k, n));
            let (at, bt) = (transpose(&a, m, k), transpose(&b, k, n));
            let lefts = [Matrix::new(&a, m, k), Matrix::new(&at, k, m).transposed()];
            let rights = [Matrix::new(&b, k, n), Matrix::new(&bt, n, k).transposed()];
            for left in lefts {
                for right in rights {
                    let mut out = vec![1.0; m * n];
                    multiply(&mut out, true, left, right);
                    assert!(out.iter().zip(&expected).all(|(o, e)| (o - 1.0 - e).abs() < 1e-12));
                    multiply(&mut out, false, left, right);
                    assert!(out.iter().zip(&expected).all(|(o, e)| (o - e).abs() < 1e-12));
                }
            }
        }
    }

    #[test]
    #[should_panic(expected = "inner dimensions")]
    fn wrong_sizes_are_refused() {
        multiply(&mut [0.0f32; 4], false, Matrix::new(&[0.0; 4], 2, 2), Matrix::new(&[0.0; 6], 3, 2));
    }
}
