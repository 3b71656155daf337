//! Images on dfdx's tape: how an operation of this crate records its gradient.

use std::sync::Arc;

use dfdx::prelude::*;

use super::layout::Layout;
use super::scalar::Scalar;
use crate::error::{Error, Result};

/// A vector on the tape.
pub(crate) type Node<E> = Tensor<(usize,), E, Cpu>;

/// dfdx's gradients on the CPU.
pub(crate) type Grads<E> = Gradients<E, Cpu>;

/// The channels of an image on the tape.
pub(crate) struct Planes<E: Scalar, T = NoneTape> {
    tensor: Tensor<(usize,), E, Cpu, T>,
    /// How the values lie.
    pub layout: Layout,
    /// Whether anybody asks for the gradient with respect to these values.
    wanted: bool,
}

/// Parameters of an operation: constants, or a leaf of the tape where their gradient is asked for.
#[derive(Clone)]
pub(crate) struct Param<E: Scalar> {
    values: Arc<Vec<E>>,
    leaf: Option<Node<E>>,
}

/// Our error for dfdx's.
pub(crate) fn tape_error(error: CpuError) -> Error {
    Error::invalid("tensor", error.to_string())
}

impl<E: Scalar> Param<E> {
    /// Parameters whose gradient nobody asks for.
    pub fn constant(values: Arc<Vec<E>>) -> Self {
        Self { values, leaf: None }
    }

    /// Parameters whose gradient [`Pullback::of_param`] will give.
    #[cfg(test)]
    pub fn tracked(values: Vec<E>) -> Self {
        let leaf = Cpu::default().tensor_from_vec(values.clone(), (values.len(),));
        Self { values: Arc::new(values), leaf: Some(leaf) }
    }

    /// The values.
    pub fn values(&self) -> &[E] {
        &self.values
    }

    /// Whether the gradient is asked for.
    pub fn is_tracked(&self) -> bool {
        self.leaf.is_some()
    }

    /// Adds to the gradient, if it is asked for.
    pub fn add_gradient(&self, grads: &mut Grads<E>, add: impl FnOnce(&mut [E])) -> std::result::Result<(), CpuError> {
        match &self.leaf {
            Some(leaf) => add_gradient(grads, leaf, add),
            None => Ok(()),
        }
    }
}

/// Lets `add` add to the gradient of `node`.
pub(crate) fn add_gradient<E: Scalar>(
    grads: &mut Grads<E>,
    node: &Node<E>,
    add: impl FnOnce(&mut [E]),
) -> std::result::Result<(), CpuError> {
    add(grads.get_or_alloc_mut(node)?);
    Ok(())
}

impl<E: Scalar> Planes<E> {
    /// An image whose gradient nobody asks for.
    pub fn constant(values: Vec<E>, layout: Layout) -> Result<Self> {
        let tensor = Cpu::default().try_tensor_from_vec(values, (layout.len(),)).map_err(tape_error)?;
        Ok(Self { tensor, layout, wanted: false })
    }

    /// The same image at the start of a tape, its gradient asked for.
    pub fn traced(&self) -> Planes<E, OwnedTape<E, Cpu>> {
        Planes { tensor: self.tensor.leaky_trace(), layout: self.layout, wanted: true }
    }

    /// The same image at the start of a tape that is there for the parameters' sake only.
    #[cfg(test)]
    pub fn traced_constant(&self) -> Planes<E, OwnedTape<E, Cpu>> {
        Planes { wanted: false, ..self.traced() }
    }
}

impl<E: Scalar, T: Tape<E, Cpu>> Planes<E, T> {
    /// A copy of the values.
    pub fn values(&self) -> Vec<E> {
        self.tensor.as_vec()
    }

    /// The same image with an empty tape of the same kind, for an operation's second branch.
    pub fn branch(&self) -> Self {
        Self { tensor: self.tensor.retaped(), layout: self.layout, wanted: self.wanted }
    }

    /// The image without its tape, and the tape.
    pub fn split(self) -> (Planes<E>, T) {
        let (tensor, tape) = self.tensor.split_tape();
        (Planes { tensor, layout: self.layout, wanted: self.wanted }, tape)
    }

    /// Whether an operation on this image has to record a gradient with respect to it.
    pub fn records(&self) -> bool {
        T::OWNS_TAPE && self.wanted
    }
}

impl<E: Scalar> Planes<E> {
    /// Whether the gradient with respect to this image is asked for.
    pub fn is_wanted(&self) -> bool {
        self.wanted
    }

    /// Lets `add` add to the gradient, if it is asked for.
    pub fn add_gradient(&self, grads: &mut Grads<E>, add: impl FnOnce(&mut [E])) -> std::result::Result<(), CpuError> {
        if self.wanted { add_gradient(grads, &self.tensor, add) } else { Ok(()) }
    }

    /// The image with `tape`.
    pub fn put<T>(self, tape: T) -> Planes<E, T> {
        Planes { tensor: self.tensor.put_tape(tape), layout: self.layout, wanted: self.wanted }
    }
}

/// The result of an operation: `values`, and, if `wanted`, on `tape` what `backward` does with the gradient with respect to them.
pub(crate) fn record<E: Scalar, T: Tape<E, Cpu>>(
    values: Vec<E>,
    layout: Layout,
    mut tape: T,
    wanted: bool,
    backward: impl FnOnce(Vec<E>, &mut Grads<E>) -> std::result::Result<(), CpuError> + 'static,
) -> Result<Planes<E, T>> {
    let planes = Planes { wanted, ..Planes::constant(values, layout)? };
    if wanted {
        let tensor = planes.tensor.clone();
        tape.add_backward_op(move |grads| {
            let gradient = std::mem::take(&mut **grads.get_or_alloc_mut(&tensor)?);
            drop(tensor);
            backward(gradient, grads)
        });
    }
    Ok(planes.put(tape))
}

/// Gradients, once a tape has been run backwards.
pub(crate) struct Pullback<E: Scalar>(Grads<E>);

impl<E: Scalar> Planes<E, OwnedTape<E, Cpu>> {
    /// Runs the tape backwards from `gradient`, the gradient with respect to this image.
    pub fn pull_back(self, gradient: Vec<E>) -> Result<Pullback<E>> {
        let (planes, mut tape) = self.split();
        assert_eq!(gradient.len(), planes.layout.len(), "length of a gradient");
        tape.add_backward_op(move |grads| {
            **grads.get_or_alloc_mut(&planes.tensor)? = gradient;
            Ok(())
        });
        // dfdx starts from a scalar: this one only carries the tape.
        let start: Tensor<Rank0, E, Cpu> = Cpu::default().try_zeros().map_err(tape_error)?;
        Ok(Pullback(start.put_tape(tape).try_backward().map_err(tape_error)?))
    }
}

impl<E: Scalar> Pullback<E> {
    /// Takes the gradient with respect to `planes` out.
    pub fn of(&mut self, planes: &Planes<E>) -> Result<Vec<E>> {
        Ok(std::mem::take(&mut **self.0.get_or_alloc_mut(&planes.tensor).map_err(tape_error)?))
    }

    /// The gradient with respect to `param`, where it is tracked.
    #[cfg(test)]
    pub fn of_param(&mut self, param: &Param<E>) -> Option<Vec<E>> {
        let leaf = param.leaf.as_ref()?;
        Some(self.0.get_or_alloc_mut(leaf).ok()?.to_vec())
    }
}
