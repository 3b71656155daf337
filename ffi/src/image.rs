//! Pixels in the host's memory.

use std::ffi::c_void;

use half::f16;
use svbrdf_gcn::Image;
use svbrdf_gcn::io::{MAX_DECODED_BYTES, Samples};

use crate::options::{SizeFirst, choose, init, read, write};
use crate::status::svbrdf_gcn_status::*;
use crate::status::{Failure, Result, svbrdf_gcn_status};
use svbrdf_gcn_pixel_type::*;

/// What a channel of a pixel is stored as.
#[repr(i32)]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum svbrdf_gcn_pixel_type {
    /// `uint8_t`; 255 stands for 1.
    SVBRDF_GCN_PIXEL_UINT8 = 1,
    /// `uint16_t`; 65535 stands for 1.
    SVBRDF_GCN_PIXEL_UINT16 = 2,
    /// IEEE 754 half float, 2 bytes.
    SVBRDF_GCN_PIXEL_HALF = 3,
    /// `float`.
    SVBRDF_GCN_PIXEL_FLOAT = 4,
}

/// Pixels to be read. The value of channel c of the pixel in row y and column x is stored at
/// `data + y * row_stride + x * pixel_stride + c * channel_stride`; row 0 is the top one.
///
/// Strides are in bytes and may be negative; `data` always points to the first channel of the top left pixel. A stride of 0 stands for a packed one:
/// channels side by side, then pixels, then rows (or, with strides given, whatever they leave: a row is then `width` pixels). Values need not be aligned.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct svbrdf_gcn_image_view {
    /// `sizeof(svbrdf_gcn_image_view)`.
    pub struct_size: usize,
    /// The top left pixel.
    pub data: *const c_void,
    /// A `svbrdf_gcn_pixel_type`.
    pub pixel_type: i32,
    /// Values per pixel. Photos: 1 (grey), 2 (grey, alpha), 3 (RGB) or 4 (RGB, alpha); alpha is ignored with a warning.
    pub channels: i32,
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Bytes from a row to the one below.
    pub row_stride: isize,
    /// Bytes from a pixel to its right neighbour.
    pub pixel_stride: isize,
    /// Bytes from a channel to the next.
    pub channel_stride: isize,
}

/// Pixels to be written: as `svbrdf_gcn_image_view`.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct svbrdf_gcn_image_buffer {
    /// `sizeof(svbrdf_gcn_image_buffer)`.
    pub struct_size: usize,
    /// The top left pixel.
    pub data: *mut c_void,
    /// `SVBRDF_GCN_PIXEL_FLOAT` or `SVBRDF_GCN_PIXEL_HALF`.
    pub pixel_type: i32,
    /// Values per pixel.
    pub channels: i32,
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Bytes from a row to the one below.
    pub row_stride: isize,
    /// Bytes from a pixel to its right neighbour.
    pub pixel_stride: isize,
    /// Bytes from a channel to the next.
    pub channel_stride: isize,
}

impl SizeFirst for svbrdf_gcn_image_view {
    const NAME: &'static str = "svbrdf_gcn_image_view";

    fn defaults() -> Self {
        Self {
            struct_size: size_of::<Self>(),
            data: std::ptr::null(),
            pixel_type: 0,
            channels: 0,
            width: 0,
            height: 0,
            row_stride: 0,
            pixel_stride: 0,
            channel_stride: 0,
        }
    }
}

impl SizeFirst for svbrdf_gcn_image_buffer {
    const NAME: &'static str = "svbrdf_gcn_image_buffer";

    fn defaults() -> Self {
        Self {
            struct_size: size_of::<Self>(),
            data: std::ptr::null_mut(),
            pixel_type: 0,
            channels: 0,
            width: 0,
            height: 0,
            row_stride: 0,
            pixel_stride: 0,
            channel_stride: 0,
        }
    }
}

/// Sets `struct_size` and makes everything else 0: packed strides; the rest has to be filled in.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn svbrdf_gcn_image_view_init(
    view: *mut svbrdf_gcn_image_view,
    struct_size: usize,
) -> svbrdf_gcn_status {
    // SAFETY: `view` has `struct_size` bytes, says the caller.
    unsafe { init("view", view, struct_size) }
}

/// Sets `struct_size` and makes everything else 0: packed strides; the rest has to be filled in.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn svbrdf_gcn_image_buffer_init(
    buffer: *mut svbrdf_gcn_image_buffer,
    struct_size: usize,
) -> svbrdf_gcn_status {
    // SAFETY: `buffer` has `struct_size` bytes, says the caller.
    unsafe { init("buffer", buffer, struct_size) }
}

/// Writes a view of the values of `image`, which the caller keeps alive, to `out`.
///
/// # Safety
/// `out` is NULL or points to a struct whose first field is its size.
pub(crate) unsafe fn view_of(image: &Image, out: *mut svbrdf_gcn_image_view) -> Result<()> {
    let (pixel, row) = (image.channels() * size_of::<f32>(), image.width() * image.channels() * size_of::<f32>());
    let view = svbrdf_gcn_image_view {
        data: image.data().as_ptr().cast(),
        pixel_type: SVBRDF_GCN_PIXEL_FLOAT as i32,
        channels: image.channels() as i32,
        width: image.width(),
        height: image.height(),
        row_stride: row as isize,
        pixel_stride: pixel as isize,
        channel_stride: size_of::<f32>() as isize,
        ..svbrdf_gcn_image_view::defaults()
    };
    // SAFETY: the caller's word.
    unsafe { write("out", view, out) }
}

/// Where the values of an image lie, checked.
struct Layout {
    kind: svbrdf_gcn_pixel_type,
    width: usize,
    height: usize,
    channels: usize,
    row: isize,
    pixel: isize,
    channel: isize,
}

impl Layout {
    fn new(name: &str, view: &svbrdf_gcn_image_view) -> Result<Self> {
        if view.data.is_null() {
            return Err(Failure::null(&format!("{name}.data")));
        }
        let kind = choose(
            &format!("{name}.pixel_type"),
            view.pixel_type,
            &[SVBRDF_GCN_PIXEL_UINT8, SVBRDF_GCN_PIXEL_UINT16, SVBRDF_GCN_PIXEL_HALF, SVBRDF_GCN_PIXEL_FLOAT]
                .map(|kind| (kind as i32, kind)),
        )
        .map_err(|failure| Failure { status: SVBRDF_GCN_ERR_FORMAT, ..failure })?;
        let size: usize = match kind {
            SVBRDF_GCN_PIXEL_UINT8 => 1,
            SVBRDF_GCN_PIXEL_UINT16 | SVBRDF_GCN_PIXEL_HALF => 2,
            SVBRDF_GCN_PIXEL_FLOAT => 4,
        };
        let (width, height) = (view.width, view.height);
        let channels = match view.channels {
            channels @ 1..=4 => channels as usize,
            other => return Err(Failure::shape(name, format!("expected 1 to 4 channels, got {other}"))),
        };
        let bytes = [width, height, channels].iter().try_fold(size, |product, &n| product.checked_mul(n));
        match bytes {
            Some(bytes) if bytes > 0 && bytes as u64 <= MAX_DECODED_BYTES => {}
            _ => {
                return Err(Failure::shape(
                    name,
                    format!(
                        "expected at least 1 pixel and at most {MAX_DECODED_BYTES} bytes, got {width} x {height} pixels of {channels} channels"
                    ),
                ));
            }
        }
        // The product is small, so that packed strides are.
        let or_packed = |stride: isize, packed: usize| if stride == 0 { packed as isize } else { stride };
        let layout = Self {
            kind,
            width,
            height,
            channels,
            row: or_packed(view.row_stride, width * channels * size),
            pixel: or_packed(view.pixel_stride, channels * size),
            channel: or_packed(view.channel_stride, size),
        };
        // Offsets of the lowest and the highest byte; both have to be ones that can be added to a pointer.
        let steps = [(layout.row, height), (layout.pixel, width), (layout.channel, channels)];
        let reach = steps.map(|(stride, count)| stride as i128 * (count as i128 - 1));
        let low: i128 = reach.iter().filter(|&&end| end < 0).sum();
        let high: i128 = reach.iter().filter(|&&end| end > 0).sum::<i128>() + size as i128;
        if high - low > isize::MAX as i128 {
            return Err(Failure::shape(
                name,
                format!(
                    "expected strides that stay in memory, got {}, {} and {} bytes for {height} rows of {width} pixels of {channels} channels",
                    layout.row, layout.pixel, layout.channel
                ),
            ));
        }
        Ok(layout)
    }

    /// Values in all.
    fn len(&self) -> usize {
        self.width * self.height * self.channels
    }

    /// The offset of the first value of a pixel.
    fn offset(&self, row: usize, column: usize) -> isize {
        row as isize * self.row + column as isize * self.pixel
    }

    /// Reads all values, row by row.
    ///
    /// # Safety
    /// At `data` values of type `T` lie as `self` says.
    unsafe fn gather<T: Copy, U>(&self, data: *const c_void, convert: impl Fn(T) -> U) -> Result<Vec<U>> {
        let mut values = Vec::new();
        values.try_reserve_exact(self.len()).map_err(|_| Failure {
            status: SVBRDF_GCN_ERR_OUT_OF_MEMORY,
            message: format!("no memory for a copy of {} x {} pixels", self.width, self.height),
        })?;
        for row in 0..self.height {
            for column in 0..self.width {
                let pixel = data.wrapping_byte_offset(self.offset(row, column)).cast::<T>();
                for channel in 0..self.channels as isize {
                    // SAFETY: a value of the image, says the caller; it may be unaligned.
                    let value = unsafe { pixel.wrapping_byte_offset(channel * self.channel).read_unaligned() };
                    values.push(convert(value));
                }
            }
        }
        Ok(values)
    }

    /// Writes all values, row by row.
    ///
    /// # Safety
    /// At `data` there is place for values of type `T` as `self` says.
    unsafe fn scatter<T>(&self, data: *mut c_void, values: &[f32], convert: impl Fn(f32) -> T) {
        for (p, values) in values.chunks_exact(self.channels).enumerate() {
            let pixel = data.wrapping_byte_offset(self.offset(p / self.width, p % self.width)).cast::<T>();
            for (channel, &value) in values.iter().enumerate() {
                // SAFETY: a value of the image, says the caller; it may be unaligned.
                unsafe {
                    pixel.wrapping_byte_offset(channel as isize * self.channel).write_unaligned(convert(value));
                }
            }
        }
    }
}

/// A packed copy of an image of the host.
#[derive(Debug)]
pub(crate) struct HostImage {
    pub width: usize,
    pub height: usize,
    pub channels: usize,
    values: Values,
}

#[derive(Debug, PartialEq)]
enum Values {
    U8(Vec<u8>),
    U16(Vec<u16>),
    F32(Vec<f32>),
}

impl HostImage {
    /// Copies what `view` describes.
    ///
    /// # Safety
    /// `view` is NULL or points to a struct whose first field is its size, and its pixels lie where it says.
    pub unsafe fn read(name: &str, view: *const svbrdf_gcn_image_view) -> Result<Self> {
        // SAFETY: the caller's word.
        let view = unsafe { read(name, view) }?;
        let layout = Layout::new(name, &view)?;
        // SAFETY: the caller's word; the type is the one it states.
        let values = unsafe {
            match layout.kind {
                SVBRDF_GCN_PIXEL_UINT8 => Values::U8(layout.gather(view.data, |value: u8| value)?),
                SVBRDF_GCN_PIXEL_UINT16 => Values::U16(layout.gather(view.data, |value: u16| value)?),
                SVBRDF_GCN_PIXEL_HALF => {
                    Values::F32(layout.gather(view.data, |bits: u16| f16::from_bits(bits).to_f32())?)
                }
                SVBRDF_GCN_PIXEL_FLOAT => Values::F32(layout.gather(view.data, |value: f32| value)?),
            }
        };
        Ok(Self { width: layout.width, height: layout.height, channels: layout.channels, values })
    }

    pub fn samples(&self) -> Samples<'_> {
        match &self.values {
            Values::U8(values) => Samples::U8(values),
            Values::U16(values) => Samples::U16(values),
            Values::F32(values) => Samples::F32(values),
        }
    }
}

/// A place of the host's for an image of a stated size.
pub(crate) struct HostBuffer {
    layout: Layout,
    data: *mut c_void,
}

impl HostBuffer {
    /// Checks that `buffer` takes an image of this size.
    ///
    /// # Safety
    /// `buffer` is NULL or points to a struct whose first field is its size.
    pub unsafe fn new(
        name: &str,
        buffer: *const svbrdf_gcn_image_buffer,
        (width, height, channels): (usize, usize, usize),
    ) -> Result<Self> {
        // SAFETY: the caller's word.
        let buffer = unsafe { read(name, buffer) }?;
        let layout = Layout::new(
            name,
            &svbrdf_gcn_image_view {
                data: buffer.data,
                pixel_type: buffer.pixel_type,
                channels: buffer.channels,
                width: buffer.width,
                height: buffer.height,
                row_stride: buffer.row_stride,
                pixel_stride: buffer.pixel_stride,
                channel_stride: buffer.channel_stride,
                ..svbrdf_gcn_image_view::defaults()
            },
        )?;
        if !matches!(layout.kind, SVBRDF_GCN_PIXEL_FLOAT | SVBRDF_GCN_PIXEL_HALF) {
            return Err(Failure {
                status: SVBRDF_GCN_ERR_FORMAT,
                message: format!(
                    "{name}.pixel_type: radiance has no upper end: expected float or half, got {}",
                    buffer.pixel_type
                ),
            });
        }
        if (layout.width, layout.height, layout.channels) != (width, height, channels) {
            return Err(Failure::shape(
                name,
                format!(
                    "expected shape ({height}, {width}, {channels}), got ({}, {}, {})",
                    layout.height, layout.width, layout.channels
                ),
            ));
        }
        Ok(Self { layout, data: buffer.data })
    }

    /// Writes `image`, which has the size that was checked.
    ///
    /// # Safety
    /// The host's memory is as the buffer said.
    pub unsafe fn write(&self, image: &Image) {
        // SAFETY: the caller's word; the type is the one it states.
        unsafe {
            match self.layout.kind {
                SVBRDF_GCN_PIXEL_HALF => {
                    self.layout.scatter(self.data, image.data(), |value| f16::from_f32(value).to_bits());
                }
                _ => self.layout.scatter(self.data, image.data(), |value| value),
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::options::{
        read_or_defaults, svbrdf_gcn_capture_options, svbrdf_gcn_export_options, svbrdf_gcn_options,
        svbrdf_gcn_save_options, svbrdf_gcn_shot,
    };

    fn view<T>(
        data: &[T],
        kind: svbrdf_gcn_pixel_type,
        width: usize,
        height: usize,
        channels: i32,
    ) -> svbrdf_gcn_image_view {
        svbrdf_gcn_image_view {
            data: data.as_ptr().cast(),
            pixel_type: kind as i32,
            channels,
            width,
            height,
            ..svbrdf_gcn_image_view::defaults()
        }
    }

    fn values(view: &svbrdf_gcn_image_view) -> Values {
        // SAFETY: the tests' views are of slices that are still there.
        unsafe { HostImage::read("photo", view) }.unwrap().values
    }

    #[test]
    fn any_strides() {
        // Two rows of two pixels of two channels, in every order.
        let packed: Vec<u8> = (0..8).collect();
        let full = view(&packed, SVBRDF_GCN_PIXEL_UINT8, 2, 2, 2);
        assert_eq!(values(&full), Values::U8(packed.clone()));
        let bottom_up = svbrdf_gcn_image_view { data: packed[4..].as_ptr().cast(), row_stride: -4, ..full };
        assert_eq!(values(&bottom_up), Values::U8(vec![4, 5, 6, 7, 0, 1, 2, 3]));
        let mirrored = svbrdf_gcn_image_view { data: packed[2..].as_ptr().cast(), pixel_stride: -2, ..full };
        assert_eq!(values(&mirrored), Values::U8(vec![2, 3, 0, 1, 6, 7, 4, 5]));
        let swapped = svbrdf_gcn_image_view { data: packed[1..].as_ptr().cast(), channel_stride: -1, ..full };
        assert_eq!(values(&swapped), Values::U8(vec![1, 0, 3, 2, 5, 4, 7, 6]));
        let planar = svbrdf_gcn_image_view { channel_stride: 4, pixel_stride: 1, row_stride: 2, ..full };
        assert_eq!(values(&planar), Values::U8(vec![0, 4, 1, 5, 2, 6, 3, 7]));
    }

    #[test]
    fn any_type_unaligned() {
        let halves: Vec<u16> = [0.5f32, 65504.0].map(|value| f16::from_f32(value).to_bits()).to_vec();
        assert_eq!(values(&view(&halves, SVBRDF_GCN_PIXEL_HALF, 2, 1, 1)), Values::F32(vec![0.5, 65504.0]));
        assert_eq!(values(&view(&[7u16, 65535], SVBRDF_GCN_PIXEL_UINT16, 1, 2, 1)), Values::U16(vec![7, 65535]));
        let mut bytes = vec![0u8];
        bytes.extend([1.5f32, -2.0].iter().flat_map(|value| value.to_ne_bytes()));
        assert_eq!(values(&view(&bytes[1..], SVBRDF_GCN_PIXEL_FLOAT, 2, 1, 1)), Values::F32(vec![1.5, -2.0]));
    }

    #[test]
    fn sizes_that_overflow_are_errors() {
        let pixels = [0u8; 4];
        let good = view(&pixels, SVBRDF_GCN_PIXEL_UINT8, 2, 2, 1);
        let status = |view: svbrdf_gcn_image_view| {
            // SAFETY: views that do not describe the four bytes are refused before they are read.
            unsafe { HostImage::read("photo", &view) }.unwrap_err().status
        };
        for (width, height) in [(0, 2), (2, 0), (usize::MAX, 2), (1 << 32, 1 << 32), (1 << 20, 1 << 20)] {
            assert_eq!(status(svbrdf_gcn_image_view { width, height, ..good }), SVBRDF_GCN_ERR_SHAPE);
        }
        for stride in [isize::MAX, isize::MIN] {
            let row = svbrdf_gcn_image_view { row_stride: stride, ..good };
            assert_eq!(status(row), SVBRDF_GCN_ERR_SHAPE);
            assert_eq!(status(svbrdf_gcn_image_view { pixel_stride: stride, ..row }), SVBRDF_GCN_ERR_SHAPE);
        }
        assert_eq!(status(svbrdf_gcn_image_view { channels: 5, ..good }), SVBRDF_GCN_ERR_SHAPE);
        assert_eq!(status(svbrdf_gcn_image_view { channels: -1, ..good }), SVBRDF_GCN_ERR_SHAPE);
        assert_eq!(status(svbrdf_gcn_image_view { pixel_type: 9, ..good }), SVBRDF_GCN_ERR_FORMAT);
        assert_eq!(status(svbrdf_gcn_image_view { data: std::ptr::null(), ..good }), SVBRDF_GCN_ERR_NULL);
        assert_eq!(status(svbrdf_gcn_image_view { struct_size: 12, ..good }), SVBRDF_GCN_ERR_STRUCT_SIZE);
    }

    /// Structs with no more memory than their first field, which says that there is no more: nothing else of them is read, or written.
    #[test]
    fn short_structs_are_refused_by_their_size_alone() {
        fn refused<T: SizeFirst, U>(call: impl Fn(*mut T) -> Result<U>) {
            for size in [0, size_of::<usize>(), T::FIRST_SIZE - 1] {
                // Exactly as many bytes as there are said to be, but for the size itself; and at odd addresses too.
                let mut bytes = vec![0xa5u8; size.max(size_of::<usize>()) + 1];
                for shift in [0, 1] {
                    let place = &mut bytes[shift..];
                    place[..size_of::<usize>()].copy_from_slice(&size.to_ne_bytes());
                    let before = place.to_vec();
                    let failure = call(place.as_mut_ptr().cast()).err().unwrap();
                    assert_eq!(failure.status, SVBRDF_GCN_ERR_STRUCT_SIZE, "{}: {}", T::NAME, failure.message);
                    assert!(failure.message.ends_with(&format!("got {size}")), "{}", failure.message);
                    assert_eq!(place, before, "{}", T::NAME);
                }
            }
        }
        // SAFETY: the size comes first.
        refused(|theirs| unsafe { HostBuffer::new("out", theirs, (1, 1, 3)) });
        // SAFETY: likewise.
        refused(|theirs| unsafe { HostImage::read("pixels", theirs) });
        // SAFETY: likewise.
        refused(|theirs| unsafe { view_of(&Image::new(1, 1, 1, vec![0.5])?, theirs) });
        // SAFETY: likewise.
        refused(|theirs| unsafe { read::<svbrdf_gcn_shot>("shot", theirs) });
        // SAFETY: likewise.
        refused(|theirs| unsafe { read::<svbrdf_gcn_capture_options>("options", theirs) });
        // SAFETY: likewise.
        refused(|theirs| unsafe { read_or_defaults::<svbrdf_gcn_options>("options", theirs) });
        // SAFETY: likewise.
        refused(|theirs| unsafe { read_or_defaults::<svbrdf_gcn_save_options>("options", theirs) });
        // SAFETY: likewise.
        refused(|theirs| unsafe { read::<svbrdf_gcn_export_options>("options", theirs) });
    }

    /// A whole struct at an odd address is a struct as any other.
    #[test]
    fn structs_need_not_be_aligned() {
        let mut pixels = [0.0f32; 3];
        let buffer = svbrdf_gcn_image_buffer {
            data: pixels.as_mut_ptr().cast(),
            pixel_type: SVBRDF_GCN_PIXEL_FLOAT as i32,
            channels: 3,
            width: 1,
            height: 1,
            ..svbrdf_gcn_image_buffer::defaults()
        };
        let mut bytes = vec![0u8; size_of::<svbrdf_gcn_image_buffer>() + 1];
        let place: *mut svbrdf_gcn_image_buffer = bytes[1..].as_mut_ptr().cast();
        // SAFETY: there is room for a buffer at `place`, and for three floats at its pixels.
        unsafe {
            place.write_unaligned(buffer);
            let image = Image::new(1, 1, 3, vec![0.25, 0.5, 1.0]).unwrap();
            HostBuffer::new("out", place, (1, 1, 3)).unwrap().write(&image);
        }
        assert_eq!(pixels, [0.25, 0.5, 1.0]);
    }

    /// A number that is small, at an end of its range, or anything.
    fn size() -> impl Strategy<Value = usize> {
        prop_oneof![0usize..6, Just(usize::MAX), Just(usize::MAX / 2), Just(1 << 31), any::<usize>()]
    }

    fn stride() -> impl Strategy<Value = isize> {
        prop_oneof![-40isize..40, Just(isize::MAX), Just(isize::MIN), Just(1 << 62), any::<isize>()]
    }

    proptest! {
        /// Whatever a descriptor says, it is refused or every value it names lies in the bytes that were checked, and is read once.
        #[test]
        fn any_descriptor(
            (width, height, channels) in (size(), size(), prop_oneof![-1i32..7, any::<i32>()]),
            (row_stride, pixel_stride, channel_stride) in (stride(), stride(), stride()),
            pixel_type in prop_oneof![0i32..6, any::<i32>()],
        ) {
            let view = svbrdf_gcn_image_view {
                data: std::ptr::dangling(),
                pixel_type, channels, width, height, row_stride, pixel_stride, channel_stride,
                ..svbrdf_gcn_image_view::defaults()
            };
            let Ok(layout) = Layout::new("pixels", &view) else { return Ok(()) };
            prop_assume!(layout.len() < 1000);
            let size = [1, 2, 2, 4][layout.kind as usize - 1];
            let offsets: Vec<isize> = (0..height)
                .flat_map(|y| (0..width).map(move |x| (y, x)))
                .flat_map(|(y, x)| (0..channels as isize).map(move |c| (y, x, c)))
                .map(|(y, x, c)| layout.offset(y, x) + c * layout.channel)
                .collect();
            prop_assert_eq!(offsets.len(), layout.len());
            let (low, high) = (*offsets.iter().min().unwrap(), *offsets.iter().max().unwrap() + size);
            if high - low > 1 << 16 {
                return Ok(());
            }
            let bytes: Vec<u8> = (0..high - low).map(|i| (i % 251) as u8).collect();
            let top_left = bytes.as_ptr().wrapping_offset(-low);
            // SAFETY: there are bytes for all offsets.
            let image = unsafe { HostImage::read("pixels", &svbrdf_gcn_image_view { data: top_left.cast(), ..view }) }.unwrap();
            prop_assert_eq!(image.samples().len(), offsets.len());
            if let Values::U8(values) = &image.values {
                let expected: Vec<u8> = offsets.iter().map(|offset| bytes[(offset - low) as usize]).collect();
                prop_assert_eq!(values, &expected);
            }
        }
    }
}
