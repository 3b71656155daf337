//! The C interface as a careless host calls it: structs of any size and any bits, images of any layout, numbers of any value.
//!
//! Hosts tell the truth about one thing, as the header asks: memory that they point to is there. Every struct and every image has an allocation of
//! exactly the bytes that it states, so that AddressSanitizer sees one byte too many.
#![no_main]

use std::cell::LazyCell;
use std::ffi::{CStr, CString, c_void};
use std::mem::offset_of;
use std::ptr;

use libfuzzer_sys::arbitrary::{Result, Unstructured};
use libfuzzer_sys::fuzz_target;
use svbrdf_gcn::io::MAX_DECODED_BYTES;
use svbrdf_gcn::io::material::SaveOptions;
use svbrdf_gcn::{Image, Material};
use svbrdf_gcn_ffi::capture::*;
use svbrdf_gcn_ffi::image::*;
use svbrdf_gcn_ffi::material::*;
use svbrdf_gcn_ffi::options::*;
use svbrdf_gcn_ffi::progress::*;
use svbrdf_gcn_ffi::status::svbrdf_gcn_status::*;
use svbrdf_gcn_ffi::status::*;
use tempfile::TempDir;

/// Pixels of a side of the material.
const SIDE: usize = 8;
/// Largest allocation for an image.
const IMAGE_MAX: i128 = 1 << 16;

struct Scene {
    folder: TempDir,
    material: *mut svbrdf_gcn_material,
}

thread_local! {
    static SCENE: LazyCell<Scene> = LazyCell::new(|| {
        let folder = TempDir::new().expect("a temporary folder");
        let image = |channels: usize| Image::new(SIDE, SIDE, channels, vec![0.4; SIDE * SIDE * channels]).expect("an image");
        let normal = (0..3 * SIDE * SIDE).map(|i| if i % 3 == 2 { 1.0 } else { 0.0 }).collect();
        let material = Material {
            diffuse_albedo: image(3),
            specular_albedo: image(3),
            roughness: image(1),
            normal: Image::new(SIDE, SIDE, 3, normal).expect("an image"),
            tangent: None,
            patch_size: 2.0,
            unit: None,
            warnings: Vec::new(),
        };
        material.save(folder.path().join("maps"), &SaveOptions::default()).expect("a saved material");
        let path = CString::new(folder.path().join("maps").to_str().expect("UTF-8")).expect("no NUL");
        let mut material = ptr::null_mut();
        check(unsafe { svbrdf_gcn_material_load(path.as_ptr(), &raw mut material) });
        assert!(!material.is_null());
        Scene { folder, material }
    });
}

fuzz_target!(|bytes: &[u8]| {
    SCENE.with(|scene| {
        let _ = run(scene, &mut Unstructured::new(bytes));
    });
});

/// Failures say something.
fn check(status: svbrdf_gcn_status) -> bool {
    let message = unsafe { CStr::from_ptr(svbrdf_gcn_last_error_message()) };
    let message = message.to_str().expect("UTF-8");
    assert!(status == SVBRDF_GCN_OK || !message.is_empty(), "a failure without a message");
    assert!(status != SVBRDF_GCN_ERR_INTERNAL, "{message}");
    status == SVBRDF_GCN_OK
}

/// A struct of the host: as many bytes as it states.
struct Struct<T> {
    bytes: Box<[u8]>,
    kind: std::marker::PhantomData<T>,
}

impl<T: Copy> Struct<T> {
    /// The defaults, with some of their fields changed.
    fn new(source: &mut Unstructured<'_>, init: unsafe extern "C" fn(*mut T, usize) -> svbrdf_gcn_status) -> Result<Self> {
        let size = match source.int_in_range(0..=9)? {
            0 => source.int_in_range(size_of::<usize>()..=2 * size_of::<T>())?,
            _ => size_of::<T>(),
        };
        let mut made = Self { bytes: vec![0; size].into(), kind: std::marker::PhantomData };
        if !check(unsafe { init(made.pointer(), size) }) {
            made.bytes.fill(source.arbitrary()?);
        }
        for _ in 0..source.int_in_range(0..=6)? {
            // Small numbers are more often good.
            let number: i64 = if source.ratio(3, 4)? { source.int_in_range(-2..=12)? } else { source.arbitrary()? };
            let at = size_of::<i32>() * source.int_in_range(2..=size_of::<T>() / 4)?;
            if source.arbitrary()? { made.set_at(at, number) } else { made.set_at(at, number as i32) }
        }
        made.set_at(0, if source.ratio(1, 40)? { source.int_in_range(0..=size)? } else { size });
        Ok(made)
    }

    fn set_at<U: Copy>(&mut self, offset: usize, value: U) {
        if offset + size_of::<U>() <= self.bytes.len() {
            unsafe { self.bytes.as_mut_ptr().add(offset).cast::<U>().write_unaligned(value) };
        }
    }

    fn pointer(&mut self) -> *mut T {
        self.bytes.as_mut_ptr().cast()
    }

    /// The struct, if it is whole.
    fn get(&self) -> Option<T> {
        (self.bytes.len() >= size_of::<T>()).then(|| unsafe { self.bytes.as_ptr().cast::<T>().read_unaligned() })
    }
}

/// Bytes from the lowest to beyond the highest that an image's layout reaches, and where the first pixel is in them; nothing for what has to be refused.
fn reach(pixel_type: i32, channels: i32, width: usize, height: usize, strides: [isize; 3]) -> Option<(i128, i128)> {
    let size: i128 = match pixel_type {
        1 => 1,
        2 | 3 => 2,
        4 => 4,
        _ => return None,
    };
    let (channels, width, height) = (i128::from(channels), width as i128, height as i128);
    let bytes = size.checked_mul(width)?.checked_mul(height)?.checked_mul(channels)?;
    if !(1..=4).contains(&channels) || !(1..=i128::from(MAX_DECODED_BYTES)).contains(&bytes) {
        return None;
    }
    let packed = [width * channels * size, channels * size, size];
    let counts = [height, width, channels];
    let (mut low, mut high) = (0, size);
    for ((stride, packed), count) in strides.into_iter().zip(packed).zip(counts) {
        let end = if stride == 0 { packed } else { stride as i128 } * (count - 1);
        if end < 0 { low += end } else { high += end }
    }
    (high - low <= isize::MAX as i128).then_some((high - low, -low))
}

fn stride(source: &mut Unstructured<'_>) -> Result<isize> {
    Ok(match source.int_in_range(0..=9)? {
        0..=4 => 0,
        5..=8 => source.int_in_range(-100..=100)?,
        _ => source.arbitrary()?,
    })
}

fn side(source: &mut Unstructured<'_>) -> Result<usize> {
    Ok(match source.int_in_range(0..=9)? {
        0..=5 => SIDE,
        6..=8 => source.int_in_range(0..=9)?,
        _ => source.arbitrary()?,
    })
}

/// The memory of an image of the host.
fn pixels(reach: Option<(i128, i128)>, source: &mut Unstructured<'_>) -> Result<Option<(Vec<u8>, usize)>> {
    let (bytes, first) = reach.unwrap_or((1, 0));
    if bytes > IMAGE_MAX {
        return Ok(None);
    }
    let mut memory = Vec::with_capacity(bytes as usize);
    memory.resize(bytes as usize, source.arbitrary()?);
    for byte in memory.iter_mut().take(64) {
        *byte = source.arbitrary()?;
    }
    Ok(Some((memory, first as usize)))
}

unsafe extern "C" fn stop(_: *mut c_void, _: *const svbrdf_gcn_progress) -> i32 {
    svbrdf_gcn_step::SVBRDF_GCN_STOP as i32
}

fn text(source: &mut Unstructured<'_>) -> Result<Option<CString>> {
    let bytes: Vec<u8> = source.arbitrary()?;
    Ok(if source.arbitrary()? { CString::new(bytes).ok() } else { None })
}

fn pointer(text: &Option<CString>) -> *const std::ffi::c_char {
    text.as_ref().map_or(ptr::null(), |text| text.as_ptr())
}

fn shot(source: &mut Unstructured<'_>) -> Result<(Struct<svbrdf_gcn_shot>, Option<CString>)> {
    let mut shot = Struct::new(source, svbrdf_gcn_shot_init)?;
    let near: f64 = source.int_in_range(1..=9)?.into();
    for field in [offset_of!(svbrdf_gcn_shot, camera), offset_of!(svbrdf_gcn_shot, light), offset_of!(svbrdf_gcn_shot, light_intensity)] {
        for axis in 0..3 {
            let value = if source.ratio(15, 16)? { near } else { source.arbitrary()? };
            shot.set_at(field + 8 * axis, value);
        }
    }
    let name = text(source)?;
    shot.set_at(offset_of!(svbrdf_gcn_shot, name), pointer(&name));
    Ok((shot, name))
}

fn run(scene: &Scene, source: &mut Unstructured<'_>) -> Result<()> {
    let mut token = ptr::null_mut();
    check(unsafe { svbrdf_gcn_cancel_token_create(&raw mut token) });
    if source.ratio(1, 40)? {
        check(unsafe { svbrdf_gcn_cancel_token_cancel(token) });
    }
    let result = with_token(scene, source, token);
    unsafe { svbrdf_gcn_cancel_token_destroy(token) };
    result
}

fn with_token(scene: &Scene, source: &mut Unstructured<'_>, token: *mut svbrdf_gcn_cancel_token) -> Result<()> {
    let mut options: Struct<svbrdf_gcn_capture_options> = Struct::new(source, svbrdf_gcn_capture_options_init)?;
    let views = [source.arbitrary::<usize>()?, 0];
    let count = source.int_in_range(0..=2)?;
    options.set_at(offset_of!(svbrdf_gcn_capture_options, views), if count == 0 { ptr::null() } else { views.as_ptr() });
    options.set_at(offset_of!(svbrdf_gcn_capture_options, view_count), count);
    options.set_at(offset_of!(svbrdf_gcn_capture_options, cancel), token.cast_const());
    if source.ratio(7, 8)? {
        options.set_at(offset_of!(svbrdf_gcn_capture_options, transfer), source.int_in_range(0..=2)?);
    }
    let mut capture = ptr::null_mut();
    let patch_size = if source.ratio(7, 8)? { 2.0 } else { source.arbitrary()? };
    if !check(unsafe { svbrdf_gcn_capture_create(patch_size, options.pointer(), &raw mut capture) }) {
        assert!(capture.is_null());
    } else {
        let result = with_capture(scene, source, token, capture);
        unsafe { svbrdf_gcn_capture_destroy(capture) };
        result?;
    }
    with_material(scene, source)
}

fn with_capture(scene: &Scene, source: &mut Unstructured<'_>, token: *mut svbrdf_gcn_cancel_token, capture: *mut svbrdf_gcn_capture) -> Result<()> {
    for _ in 0..source.int_in_range(1..=3)? {
        let mut view: Struct<svbrdf_gcn_image_view> = Struct::new(source, svbrdf_gcn_image_view_init)?;
        if source.ratio(7, 8)? {
            view.set_at(offset_of!(svbrdf_gcn_image_view, pixel_type), source.int_in_range(1..=4)?);
            view.set_at(offset_of!(svbrdf_gcn_image_view, channels), source.int_in_range(1..=4)?);
        }
        view.set_at(offset_of!(svbrdf_gcn_image_view, width), side(source)?);
        view.set_at(offset_of!(svbrdf_gcn_image_view, height), side(source)?);
        for field in [offset_of!(svbrdf_gcn_image_view, row_stride), offset_of!(svbrdf_gcn_image_view, pixel_stride), offset_of!(svbrdf_gcn_image_view, channel_stride)] {
            view.set_at(field, stride(source)?);
        }
        let reach = view.get().and_then(|v| reach(v.pixel_type, v.channels, v.width, v.height, [v.row_stride, v.pixel_stride, v.channel_stride]));
        let Some((memory, first)) = pixels(reach, source)? else { continue };
        view.set_at(offset_of!(svbrdf_gcn_image_view, data), memory[first..].as_ptr());
        let (mut shot, _name) = shot(source)?;
        let before = unsafe { svbrdf_gcn_capture_photo_count(capture) };
        let added = check(unsafe { svbrdf_gcn_capture_add_photo(capture, view.pointer(), shot.pointer()) });
        assert_eq!(unsafe { svbrdf_gcn_capture_photo_count(capture) }, before + usize::from(added));
        assert!(!added || reach.is_some(), "an image that has to be refused");
    }
    let index = source.int_in_range(0..=3)?;
    let mut out: Struct<svbrdf_gcn_image_view> = Struct::new(source, svbrdf_gcn_image_view_init)?;
    if check(unsafe { svbrdf_gcn_capture_photo(capture, index, out.pointer()) }) {
        look_at(&out);
    }
    let mut rmse = -1.0;
    if check(unsafe { svbrdf_gcn_photo_rmse(scene.material, capture, index, &raw mut rmse) }) {
        assert!((0.0..=1.0).contains(&rmse), "{rmse}");
    }

    let mut options: Struct<svbrdf_gcn_options> = Struct::new(source, svbrdf_gcn_options_init)?;
    let weights = text(source)?;
    options.set_at(offset_of!(svbrdf_gcn_options, weights), pointer(&weights));
    options.set_at(offset_of!(svbrdf_gcn_options, progress), stop as *const c_void);
    options.set_at(offset_of!(svbrdf_gcn_options, progress_user_data), ptr::null::<c_void>());
    options.set_at(offset_of!(svbrdf_gcn_options, cancel), token.cast_const());
    // Hundreds of threads each time would only take long.
    if options.get().is_some_and(|options| (3..=1024).contains(&options.threads)) {
        options.set_at(offset_of!(svbrdf_gcn_options, threads), 2_i32);
    }
    let mut material = ptr::null_mut();
    let fitted = check(unsafe { svbrdf_gcn_fit_material(ptr::null(), capture, options.pointer(), &raw mut material) });
    // A callback that stops at once: no material.
    assert!(!fitted && material.is_null());
    Ok(())
}

fn with_material(scene: &Scene, source: &mut Unstructured<'_>) -> Result<()> {
    let kind = if source.ratio(7, 8)? { source.int_in_range(-1..=12)? } else { source.arbitrary()? };
    let mut out: Struct<svbrdf_gcn_image_view> = Struct::new(source, svbrdf_gcn_image_view_init)?;
    if check(unsafe { svbrdf_gcn_material_map(scene.material, kind, out.pointer()) }) {
        look_at(&out);
    }

    let (mut shot, _name) = shot(source)?;
    let mut buffer: Struct<svbrdf_gcn_image_buffer> = Struct::new(source, svbrdf_gcn_image_buffer_init)?;
    if source.ratio(7, 8)? {
        buffer.set_at(offset_of!(svbrdf_gcn_image_buffer, pixel_type), source.int_in_range(2..=4)?);
        buffer.set_at(offset_of!(svbrdf_gcn_image_buffer, channels), 3_i32);
    }
    buffer.set_at(offset_of!(svbrdf_gcn_image_buffer, width), side(source)?);
    buffer.set_at(offset_of!(svbrdf_gcn_image_buffer, height), side(source)?);
    for field in [offset_of!(svbrdf_gcn_image_buffer, row_stride), offset_of!(svbrdf_gcn_image_buffer, pixel_stride), offset_of!(svbrdf_gcn_image_buffer, channel_stride)] {
        buffer.set_at(field, stride(source)?);
    }
    let reach = buffer.get().and_then(|b| reach(b.pixel_type, b.channels, b.width, b.height, [b.row_stride, b.pixel_stride, b.channel_stride]));
    if let Some((mut memory, first)) = pixels(reach, source)? {
        buffer.set_at(offset_of!(svbrdf_gcn_image_buffer, data), memory[first..].as_mut_ptr());
        check(unsafe { svbrdf_gcn_material_render(scene.material, shot.pointer(), buffer.pointer()) });
    }

    let mut save: Struct<svbrdf_gcn_save_options> = Struct::new(source, svbrdf_gcn_save_options_init)?;
    let mut export: Struct<svbrdf_gcn_export_options> = Struct::new(source, svbrdf_gcn_export_options_init)?;
    let name = text(source)?;
    export.set_at(offset_of!(svbrdf_gcn_export_options, name), pointer(&name));
    // Writing takes long.
    if source.ratio(1, 10)? {
        let path = |name: &str| CString::new(scene.folder.path().join(name).to_str().expect("UTF-8")).expect("no NUL");
        check(unsafe { svbrdf_gcn_material_save(scene.material, path("saved").as_ptr(), save.pointer()) });
        check(unsafe { svbrdf_gcn_material_export(scene.material, path("exported").as_ptr(), export.pointer()) });
    }
    Ok(())
}

/// What the library points to is there.
fn look_at(view: &Struct<svbrdf_gcn_image_view>) {
    let Some(view) = view.get() else { return };
    let values = view.width * view.height * view.channels as usize;
    let sum: f32 = (0..values).map(|i| unsafe { view.data.cast::<f32>().add(i).read() }).sum();
    assert!(sum.is_finite());
}
