//! The loss as one operation on dfdx's tape.

use dfdx::prelude::*;

use super::{Target, photo_loss};
use crate::error::{Error, Result};
use crate::maps::{Lobe, Maps};
use crate::real::Real;

/// [`photo_loss`] of maps on a tape: a tensor (1, planes, height, width) gives the loss, and what calls `backward` on it, or on what is
/// computed from it, gets the gradient with respect to the maps.
///
/// Value and gradient are computed in one pass, the gradient only if `maps` own a tape.
///
/// # Errors
/// [`Error::ShapeMismatch`] if `maps` have not the shape that `lobe` and the targets ask for; as [`photo_loss`].
#[doc(hidden)]
pub fn photo_loss_on_tape<S, E, T>(
    maps: Tensor<S, E, Cpu, T>,
    lobe: Lobe,
    patch_size: f64,
    targets: &[Target],
) -> Result<Tensor<Rank0, E, Cpu, T>>
where
    S: Shape<Concrete = [usize; 4]>,
    E: Real + Dtype,
    T: Tape<E, Cpu>,
{
    let [batch, planes, height, width] = maps.shape().concrete();
    if (batch, planes) != (1, lobe.planes()) {
        let expected = format!("shape (1, {}, height, width)", lobe.planes());
        return Err(Error::shape("maps", expected, format!("({batch}, {planes}, {height}, {width})")));
    }
    // Free where the values lie in order already, as the gradient's do.
    let (tensor, mut tape) = maps.try_contiguous().map_err(tape_error)?.split_tape();
    let mut data = vec![E::default(); planes * height * width];
    tensor.copy_into(&mut data);
    let values = Maps::new(lobe, width, height, data)?;
    let mut gradient = T::OWNS_TAPE.then(|| values.clone());
    let loss = photo_loss(&values, patch_size, targets, gradient.as_mut())?;
    let loss = tensor.device().try_tensor_from_vec(vec![E::splat(loss)], ()).map_err(tape_error)?;
    if let Some(gradient) = gradient {
        let (maps, loss) = (tensor.ghost(), loss.ghost());
        tape.add_backward_op(move |grads| {
            let scale = grads.get_or_alloc_mut(&loss)?[0];
            let sums = grads.get_or_alloc_mut(&maps)?;
            for (sum, &slope) in sums.iter_mut().zip(gradient.data()) {
                *sum += slope * scale;
            }
            Ok(())
        });
    }
    Ok(loss.put_tape(tape))
}

fn tape_error(error: CpuError) -> Error {
    Error::invalid("maps", error.to_string())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::shot::Shot;

    fn photo(width: usize, height: usize) -> Target {
        let shot = Shot { camera: [0.2, 0.1, 2.0], light: [0.0, -0.3, 1.8], light_intensity: [9.0; 3] };
        Target::new(width, height, shot, &vec![0.4; 3 * width * height], &vec![0; width * height]).unwrap()
    }

    #[test]
    fn the_tape_scales_and_adds_the_gradient() {
        let (lobe, width, height) = (Lobe::Anisotropic, 5, 3);
        let targets = [photo(width, height)];
        let values: Vec<f64> =
            (0..lobe.planes() * width * height).map(|i| 0.5 + 0.3 * (i as f64 * 0.7).sin()).collect();
        let maps = Maps::new(lobe, width, height, values.clone()).unwrap();
        let mut gradient = maps.clone();
        let expected = photo_loss(&maps, 2.0, &targets, Some(&mut gradient)).unwrap();

        let device = Cpu::default();
        let tensor = device.tensor_from_vec(values, (1, lobe.planes(), height, width));
        let loss = photo_loss_on_tape(tensor.leaky_trace(), lobe, 2.0, &targets).unwrap();
        assert_eq!(loss.array(), expected);
        // The same maps enter twice, once with three times the weight.
        let (loss, tape) = (loss * 3.0).split_tape();
        let again = photo_loss_on_tape(tensor.clone().put_tape(tape), lobe, 2.0, &targets).unwrap();
        let gradients = (again + loss).backward();
        for (got, expected) in gradients.get(&tensor).as_vec().iter().zip(gradient.data()) {
            assert!((got - 4.0 * expected).abs() <= 1e-12 * expected.abs());
        }
        // Without a tape there is only the value.
        assert_eq!(photo_loss_on_tape(tensor, lobe, 2.0, &targets).unwrap().array(), expected);
    }

    #[test]
    fn values_in_another_order_are_put_in_order() {
        let (lobe, width, height) = (Lobe::Isotropic, 4, 3);
        let targets = [photo(width, height)];
        let values: Vec<f32> =
            (0..lobe.planes() * width * height).map(|i| 0.5 + 0.3 * (i as f32 * 0.7).sin()).collect();
        let device = Cpu::default();
        let channels_last = device.tensor_from_vec(values, (1, height, width, lobe.planes()));
        let planar: Tensor<(usize, usize, usize, usize), _, _, _> =
            channels_last.leaky_trace().permute::<_, Axes4<0, 3, 1, 2>>();
        let maps = Maps::new(lobe, width, height, planar.as_vec()).unwrap();
        let mut gradient = maps.clone();
        let expected = photo_loss(&maps, 2.0, &targets, Some(&mut gradient)).unwrap();
        let loss = photo_loss_on_tape(planar, lobe, 2.0, &targets).unwrap();
        assert_eq!(loss.array(), expected as f32);
        let got = loss.backward().get(&channels_last).permute::<_, Axes4<0, 3, 1, 2>>().as_vec();
        assert_eq!(got, gradient.data());
    }

    #[test]
    fn wrong_shapes_are_errors() {
        let device = Cpu::default();
        let targets = [photo(2, 2)];
        for shape in [(1, 14, 2, 2), (2, 10, 2, 2), (1, 10, 4, 2), (1, 10, 0, 0)] {
            let tensor = device.tensor_from_vec(vec![0.5_f32; shape.0 * shape.1 * shape.2 * shape.3], shape);
            let error = photo_loss_on_tape(tensor, Lobe::Isotropic, 2.0, &targets).unwrap_err();
            assert!(matches!(error, Error::ShapeMismatch { .. }), "{error}");
        }
    }
}
