//! Images on dfdx's tape: how an operation of this crate records its gradient.
//!
//! dfdx gives no access to a tensor's values but by copying them, which would cost as much as many of the operations. So the values travel
//! beside the tape, shared, and the tape's tensors are empty: they only say whose gradient is meant.

use std::collections::BTreeMap;
use std::ops::{Deref, DerefMut};
use std::sync::{Arc, Mutex, PoisonError};

use dfdx::prelude::*;

use super::layout::Layout;
use super::scalar::Scalar;
use crate::error::{Error, Result};

/// Whose gradient: a tensor without values.
type Key<E, T = NoneTape> = Tensor<(usize,), E, Cpu, T>;

/// dfdx's gradients on the CPU.
pub(crate) type Grads<E> = Gradients<E, Cpu>;

/// What a step of the way back returns.
pub(crate) type Returned = std::result::Result<(), CpuError>;

fn key<E: Scalar>() -> Result<Key<E>> {
    Cpu::default().try_tensor_from_vec(Vec::new(), (0,)).map_err(tape_error)
}

/// Our error for dfdx's.
fn tape_error(error: CpuError) -> Error {
    Error::invalid("tensor", error.to_string())
}

/// Memory that operations use again: what they free comes back here, so that only the first step of a fit has it from the system.
#[derive(Clone, Default)]
pub(crate) struct Pool<E>(Arc<Mutex<BTreeMap<usize, Vec<Vec<E>>>>>);

impl<E: Scalar> Pool<E> {
    /// `len` values, whatever they are.
    pub fn take(&self, len: usize) -> Buffer<E> {
        let free = self.0.lock().unwrap_or_else(PoisonError::into_inner).get_mut(&len).and_then(Vec::pop);
        Buffer { values: free.unwrap_or_else(|| vec![E::default(); len]), pool: self.clone() }
    }

    /// A copy of `values`.
    pub fn copy(&self, values: &[E]) -> Buffer<E> {
        let mut buffer = self.take(values.len());
        buffer.copy_from_slice(values);
        buffer
    }

    /// `len` zeros.
    pub fn zeros(&self, len: usize) -> Buffer<E> {
        let mut buffer = self.take(len);
        buffer.fill(E::default());
        buffer
    }

    /// Gives the memory that is not in use back to the system.
    pub fn release(&self) {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).clear();
    }

    fn adopt(&self, values: Vec<E>) -> Buffer<E> {
        Buffer { values, pool: self.clone() }
    }
}

/// Values that go back to their pool when dropped.
pub(crate) struct Buffer<E: Scalar> {
    values: Vec<E>,
    pool: Pool<E>,
}

impl<E: Scalar> Buffer<E> {
    fn into_vec(mut self) -> Vec<E> {
        std::mem::take(&mut self.values)
    }
}

impl<E: Scalar> Drop for Buffer<E> {
    fn drop(&mut self) {
        let values = std::mem::take(&mut self.values);
        if !values.is_empty() {
            self.pool.0.lock().unwrap_or_else(PoisonError::into_inner).entry(values.len()).or_default().push(values);
        }
    }
}

impl<E: Scalar> Deref for Buffer<E> {
    type Target = [E];

    fn deref(&self) -> &[E] {
        &self.values
    }
}

impl<E: Scalar> DerefMut for Buffer<E> {
    fn deref_mut(&mut self) -> &mut [E] {
        &mut self.values
    }
}

/// Parameters of an operation: constants, or a leaf of the tape where their gradient is asked for.
#[derive(Clone)]
pub(crate) struct Param<E: Scalar> {
    values: Arc<Vec<E>>,
    leaf: Option<Key<E>>,
}

impl<E: Scalar> Param<E> {
    /// Parameters whose gradient nobody asks for.
    pub fn constant(values: Arc<Vec<E>>) -> Self {
        Self { values, leaf: None }
    }

    /// Parameters whose gradient [`Pullback::of_param`] will give.
    #[cfg(test)]
    pub fn tracked(values: impl Into<Arc<Vec<E>>>) -> Self {
        Self { values: values.into(), leaf: key().ok() }
    }

    /// The values.
    pub fn values(&self) -> &[E] {
        &self.values
    }

    /// Whether the gradient is asked for.
    pub fn is_tracked(&self) -> bool {
        self.leaf.is_some()
    }

    /// Lets `add` add to the gradient, if it is asked for.
    pub fn add_gradient(&self, grads: &mut Grads<E>, add: impl FnOnce(&mut [E])) -> Returned {
        let Some(leaf) = &self.leaf else { return Ok(()) };
        let gradient: &mut Vec<E> = grads.get_or_alloc_mut(leaf)?;
        gradient.resize(self.values.len(), E::default());
        add(gradient);
        Ok(())
    }
}

/// Where the gradient with respect to an image goes, if anybody asks for it.
pub(crate) struct Slot<E: Scalar> {
    key: Key<E>,
    wanted: bool,
}

impl<E: Scalar> Slot<E> {
    /// Whether the gradient is asked for.
    pub fn is_wanted(&self) -> bool {
        self.wanted
    }

    /// Adds what `gradient` gives to the gradient, if it is asked for.
    pub fn add(&self, grads: &mut Grads<E>, gradient: impl FnOnce() -> Buffer<E>) -> Returned {
        if !self.wanted {
            return Ok(());
        }
        let (sum, part): (&mut Vec<E>, Buffer<E>) = (grads.get_or_alloc_mut(&self.key)?, gradient());
        if sum.is_empty() {
            *sum = part.into_vec();
        } else {
            super::kernels::add(sum, &part);
        }
        Ok(())
    }
}

/// The channels of an image on the tape.
pub(crate) struct Planes<E: Scalar, T = NoneTape> {
    key: Key<E, T>,
    values: Arc<Buffer<E>>,
    /// How the values lie.
    pub layout: Layout,
    /// Whether anybody asks for the gradient with respect to these values.
    wanted: bool,
}

impl<E: Scalar> Planes<E> {
    /// An image whose gradient nobody asks for, with memory of its own.
    #[cfg(test)]
    pub fn constant(values: Vec<E>, layout: Layout) -> Result<Self> {
        Self::pooled(values, layout, &Pool::default())
    }

    /// An image whose gradient nobody asks for; operations on it take their memory from `pool`.
    pub fn pooled(values: Vec<E>, layout: Layout, pool: &Pool<E>) -> Result<Self> {
        Self::of(pool.adopt(values), layout)
    }

    /// An image of `values` whose gradient nobody asks for.
    pub fn of(values: Buffer<E>, layout: Layout) -> Result<Self> {
        if values.len() != layout.len() {
            return Err(Error::shape("planes", layout.len().to_string(), values.len().to_string()));
        }
        Ok(Self { key: key()?, values: Arc::new(values), layout, wanted: false })
    }

    /// The same image at the start of a tape, its gradient asked for.
    pub fn traced(&self) -> Planes<E, OwnedTape<E, Cpu>> {
        Planes { key: self.key.leaky_trace(), values: self.values.clone(), layout: self.layout, wanted: true }
    }

    /// The same image at the start of a tape that is there for the parameters' sake only.
    #[cfg(test)]
    pub fn traced_constant(&self) -> Planes<E, OwnedTape<E, Cpu>> {
        Planes { wanted: false, ..self.traced() }
    }

    /// Whether the gradient with respect to this image is asked for.
    pub fn is_wanted(&self) -> bool {
        self.wanted
    }

    /// Where the gradient goes, without the values: an operation that does not need them on the way back lets them go.
    pub fn slot(&self) -> Slot<E> {
        Slot { key: self.key.clone(), wanted: self.wanted }
    }

    /// Adds what `gradient` gives to the gradient, if it is asked for.
    pub fn add_gradient(&self, grads: &mut Grads<E>, gradient: impl FnOnce() -> Buffer<E>) -> Returned {
        self.slot().add(grads, gradient)
    }

    /// The values, to be changed; copied if another image shares them.
    pub fn into_buffer(self) -> Buffer<E> {
        Arc::try_unwrap(self.values).unwrap_or_else(|shared| shared.pool.copy(&shared))
    }

    /// The image with `tape`.
    pub fn put<T>(self, tape: T) -> Planes<E, T> {
        Planes { key: self.key.put_tape(tape), values: self.values, layout: self.layout, wanted: self.wanted }
    }
}

impl<E: Scalar, T: Tape<E, Cpu>> Planes<E, T> {
    /// The values.
    pub fn values(&self) -> &[E] {
        &self.values
    }

    /// Where operations on this image take their memory from.
    pub fn pool(&self) -> &Pool<E> {
        &self.values.pool
    }

    /// The same image with an empty tape of the same kind, for an operation's second branch.
    pub fn branch(&self) -> Self {
        Self { key: self.key.retaped(), values: self.values.clone(), layout: self.layout, wanted: self.wanted }
    }

    /// The image without its tape, and the tape.
    pub fn split(self) -> (Planes<E>, T) {
        let (key, tape) = self.key.split_tape();
        (Planes { key, values: self.values, layout: self.layout, wanted: self.wanted }, tape)
    }

    /// Whether an operation on this image has to record a gradient with respect to it.
    pub fn records(&self) -> bool {
        T::OWNS_TAPE && self.wanted
    }
}

/// The result of an operation: `values`, and, if `wanted`, on `tape` what `backward` does with the gradient with respect to them.
pub(crate) fn record<E: Scalar, T: Tape<E, Cpu>>(
    values: Buffer<E>,
    layout: Layout,
    mut tape: T,
    wanted: bool,
    backward: impl FnOnce(Buffer<E>, &mut Grads<E>) -> Returned + 'static,
) -> Result<Planes<E, T>> {
    let pool = values.pool.clone();
    let planes = Planes { wanted, ..Planes::of(values, layout)? };
    if wanted {
        let key = planes.key.clone();
        tape.add_backward_op(move |grads| {
            let gradient = std::mem::take::<Vec<E>>(grads.get_or_alloc_mut(&key)?);
            // Nothing came back to a result that nobody used.
            let gradient = if gradient.is_empty() { pool.zeros(layout.len()) } else { pool.adopt(gradient) };
            backward(gradient, grads)
        });
    }
    Ok(planes.put(tape))
}

/// An image as an ordinary tensor of dfdx: (1, planes, rows, columns).
pub(crate) type Image<E, T = NoneTape> = Tensor<(usize, usize, usize, usize), E, Cpu, T>;

/// A tape that records.
pub(crate) type Recording<E> = OwnedTape<E, Cpu>;

/// A loss on the tape that it was computed on.
pub(crate) type Loss<E, T = Recording<E>> = Tensor<Rank0, E, Cpu, T>;

/// `values`, planes after one another of this size, that an operation has computed; and on `tape` what `backward` does with the gradient with respect to them.
pub(crate) fn image<E: Scalar, T: Tape<E, Cpu>>(
    values: Vec<E>,
    [planes, height, width]: [usize; 3],
    mut tape: T,
    backward: impl FnOnce(&[E], &mut Grads<E>) -> Returned + 'static,
) -> Result<Image<E, T>> {
    let image = Cpu::default().try_tensor_from_vec(values, (1, planes, height, width)).map_err(tape_error)?;
    if T::OWNS_TAPE {
        let ghost = image.ghost();
        tape.add_backward_op(move |grads| {
            let gradient = std::mem::take::<Vec<E>>(grads.get_or_alloc_mut(&ghost)?);
            backward(&gradient, grads)
        });
    }
    Ok(image.put_tape(tape))
}

/// The upper left `height` x `width` pixels of `planes`, on their tape.
pub(crate) fn unpacked<E: Scalar, T: Tape<E, Cpu>>(
    planes: Planes<E, T>,
    height: usize,
    width: usize,
) -> Result<Image<E, T>> {
    let (planes, tape) = planes.split();
    let layout = planes.layout;
    let values = layout.unpack(planes.values(), height, width);
    let (slot, pool) = (planes.slot(), planes.pool().clone());
    image(values, [layout.channels, height, width], tape, move |gradient, grads| {
        slot.add(grads, || pool.adopt(layout.pack(gradient, height, width)))
    })
}

/// The end of a tape.
pub(crate) struct End<E: Scalar> {
    key: Key<E>,
    len: usize,
    tape: OwnedTape<E, Cpu>,
}

/// Gradients, once a tape has been run backwards.
pub(crate) struct Pullback<E: Scalar>(Grads<E>);

impl<E: Scalar> Planes<E, OwnedTape<E, Cpu>> {
    /// Cuts the tape off.
    pub fn cut(self) -> (Planes<E>, End<E>) {
        let (planes, tape) = self.split();
        let end = End { key: planes.key.clone(), len: planes.layout.len(), tape };
        (planes, end)
    }
}

impl<E: Scalar> End<E> {
    /// Runs the tape backwards from `gradient`, the gradient with respect to the image it was cut off from.
    pub fn pull_back(self, gradient: Vec<E>) -> Result<Pullback<E>> {
        let Self { key, len, mut tape } = self;
        if gradient.len() != len {
            return Err(Error::shape("gradient", len.to_string(), gradient.len().to_string()));
        }
        tape.add_backward_op(move |grads| {
            **grads.get_or_alloc_mut(&key)? = gradient;
            Ok(())
        });
        // dfdx starts from a scalar: this one only carries the tape.
        let start: Tensor<Rank0, E, Cpu> = Cpu::default().try_zeros().map_err(tape_error)?;
        Pullback::from(start.put_tape(tape))
    }
}

impl<E: Scalar> Pullback<E> {
    /// Runs the tape of `loss` backwards.
    pub fn from(loss: Loss<E>) -> Result<Self> {
        Ok(Self(loss.try_backward().map_err(tape_error)?))
    }

    /// Takes the gradient with respect to what `slot` stands for out; empty if it has no influence.
    pub fn of(&mut self, slot: &Slot<E>) -> Result<Vec<E>> {
        Ok(std::mem::take(&mut **self.0.get_or_alloc_mut(&slot.key).map_err(tape_error)?))
    }

    /// The gradient with respect to `param`, where it is tracked.
    #[cfg(test)]
    pub fn of_param(&mut self, param: &Param<E>) -> Option<Vec<E>> {
        let leaf = param.leaf.as_ref()?;
        let mut gradient = self.0.get_or_alloc_mut(leaf).ok()?.to_vec();
        gradient.resize(param.values.len(), E::default());
        Some(gradient)
    }
}
