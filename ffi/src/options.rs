//! Structs that grow, and the values in them.

use std::ffi::{c_char, c_void};
use std::ptr;

use svbrdf_gcn::acquire::{AcquireOptions, Corners, Sheet};
use svbrdf_gcn::capture::MAX_PHOTOS;
use svbrdf_gcn::io::material::{MaterialFormat, SaveOptions};
use svbrdf_gcn::{
    CancelToken, CaptureOptions, ColorSpace, ExportOptions, ExportTarget, FitOptions, Method, NormalConvention, Preset,
    Refine, Reflectance, Shot, Transfer,
};

use crate::guard::{guard, text};
use crate::progress::{svbrdf_gcn_cancel_token, svbrdf_gcn_progress_fn, token_or_new};
use crate::status::svbrdf_gcn_status::*;
use crate::status::{Failure, Result, svbrdf_gcn_status};
use svbrdf_gcn_color_space::*;
use svbrdf_gcn_export_target::*;
use svbrdf_gcn_format::*;
use svbrdf_gcn_method::*;
use svbrdf_gcn_normals::*;
use svbrdf_gcn_preset::*;
use svbrdf_gcn_refine::*;
use svbrdf_gcn_reflectance::*;
use svbrdf_gcn_transfer::*;

/// The largest `struct_size` that is believed.
const MAX_STRUCT_SIZE: usize = 1 << 16;

/// A struct that C allocates and whose first field is its size. All fields may hold any bits.
pub(crate) trait SizeFirst: Copy {
    /// The name in the header.
    const NAME: &'static str;
    /// The size in the first release that had the struct. When a field is added at the end, this stays the old size.
    const FIRST_SIZE: usize = size_of::<Self>();

    fn defaults() -> Self;
}

fn check_size<T: SizeFirst>(name: &str, struct_size: usize) -> Result<()> {
    if (T::FIRST_SIZE..=MAX_STRUCT_SIZE).contains(&struct_size) {
        return Ok(());
    }
    Err(Failure {
        status: SVBRDF_GCN_ERR_STRUCT_SIZE,
        message: format!(
            "{name}: expected a struct_size of {} or more as {}_init sets it, got {struct_size}",
            size_of::<T>(),
            T::NAME
        ),
    })
}

/// The struct at `theirs`, which may be shorter or longer than ours: what it has of ours, over the defaults.
///
/// # Safety
/// `theirs` is NULL or points to a struct that has as many bytes as its first field says.
pub(crate) unsafe fn read<T: SizeFirst>(name: &str, theirs: *const T) -> Result<T> {
    if theirs.is_null() {
        return Err(Failure::null(name));
    }
    // SAFETY: not NULL, and its size comes first.
    let struct_size = unsafe { theirs.cast::<usize>().read_unaligned() };
    check_size::<T>(name, struct_size)?;
    let mut ours = T::defaults();
    // SAFETY: no more than either has, and fields take any bits.
    unsafe {
        ptr::copy_nonoverlapping(
            theirs.cast::<u8>(),
            ptr::from_mut(&mut ours).cast::<u8>(),
            struct_size.min(size_of::<T>()),
        );
    }
    Ok(ours)
}

/// As [`read`], the defaults for NULL.
///
/// # Safety
/// As [`read`].
pub(crate) unsafe fn read_or_defaults<T: SizeFirst>(name: &str, theirs: *const T) -> Result<T> {
    // SAFETY: the caller's word.
    if theirs.is_null() { Ok(T::defaults()) } else { unsafe { read(name, theirs) } }
}

/// Writes as much of `ours` as the struct at `theirs` takes, whose first field stays as it is.
///
/// # Safety
/// As [`read`], and `theirs` may be written.
pub(crate) unsafe fn write<T: SizeFirst>(name: &str, ours: T, theirs: *mut T) -> Result<()> {
    if theirs.is_null() {
        return Err(Failure::null(name));
    }
    // SAFETY: not NULL, and its size comes first.
    let struct_size = unsafe { theirs.cast::<usize>().read_unaligned() };
    check_size::<T>(name, struct_size)?;
    // SAFETY: as many bytes as the caller said there are.
    unsafe { copy_out(ours, theirs, struct_size) };
    Ok(())
}

/// # Safety
/// There are `struct_size` bytes at `theirs`, no fewer than a `usize` has.
unsafe fn copy_out<T: SizeFirst>(ours: T, theirs: *mut T, struct_size: usize) {
    // SAFETY: no more than either has.
    unsafe {
        ptr::copy_nonoverlapping(
            ptr::from_ref(&ours).cast::<u8>(),
            theirs.cast::<u8>(),
            struct_size.min(size_of::<T>()),
        );
        theirs.cast::<usize>().write_unaligned(struct_size);
    }
}

/// Fills a struct with its defaults; what it has beyond ours becomes 0.
///
/// # Safety
/// `theirs` is NULL or has `struct_size` bytes.
pub(crate) unsafe fn init<T: SizeFirst>(name: &str, theirs: *mut T, struct_size: usize) -> svbrdf_gcn_status {
    guard(|| {
        if theirs.is_null() {
            return Err(Failure::null(name));
        }
        check_size::<T>(name, struct_size)?;
        // SAFETY: as many bytes as the caller said there are.
        unsafe {
            ptr::write_bytes(theirs.cast::<u8>(), 0, struct_size);
            copy_out(T::defaults(), theirs, struct_size);
        }
        Ok(())
    })
}

/// What the number `value` stands for.
pub(crate) fn choose<T: Copy>(name: &str, value: i32, known: &[(i32, T)]) -> Result<T> {
    known.iter().find(|(number, _)| *number == value).map(|(_, meaning)| *meaning).ok_or_else(|| {
        let numbers: Vec<String> = known.iter().map(|(number, _)| number.to_string()).collect();
        Failure::invalid(name, format!("expected one of {}, got {value}", numbers.join(", ")))
    })
}

/// A number that may be left open: -1.
fn given<T: TryFrom<i64>>(name: &str, value: i64) -> Result<Option<T>> {
    match T::try_from(value) {
        _ if value == -1 => Ok(None),
        Ok(number) => Ok(Some(number)),
        Err(_) => Err(Failure::invalid(name, format!("expected -1 (not given) or more, got {value}"))),
    }
}

/// How much time a fit may spend.
#[repr(i32)]
pub enum svbrdf_gcn_preset {
    /// A first look.
    SVBRDF_GCN_PRESET_DRAFT = 0,
    /// The default.
    SVBRDF_GCN_PRESET_BALANCED = 1,
    /// Until nothing is gained any more.
    SVBRDF_GCN_PRESET_HIGH = 2,
}

/// Which way leads from photos to maps.
#[repr(i32)]
pub enum svbrdf_gcn_method {
    /// The network.
    SVBRDF_GCN_METHOD_AUTO = 0,
    /// The network: the default one, fitted to the photos pixel by pixel, or that of the model or weights given.
    SVBRDF_GCN_METHOD_NETWORK = 1,
    /// Without a network: the maps themselves are optimised.
    SVBRDF_GCN_METHOD_DIRECT = 2,
}

/// What a surface is taken to be made of. All maps come out in any case.
#[repr(i32)]
pub enum svbrdf_gcn_reflectance {
    /// The simplest that predicts photos left out as well as the others do; isotropic with one or two photos.
    SVBRDF_GCN_REFLECTANCE_AUTO = 0,
    /// Lambert's law alone: specular albedo 0, roughness 1.
    SVBRDF_GCN_REFLECTANCE_DIFFUSE = 1,
    /// A specular albedo near 4 %, the same for all channels.
    SVBRDF_GCN_REFLECTANCE_DIELECTRIC = 2,
    /// Any specular albedo, metals too.
    SVBRDF_GCN_REFLECTANCE_ISOTROPIC = 3,
    /// Two roughnesses and a tangent: brushed metal, satin, hair.
    SVBRDF_GCN_REFLECTANCE_ANISOTROPIC = 4,
}

/// What of the capture's own statements a fit may correct.
#[repr(i32)]
pub enum svbrdf_gcn_refine {
    /// What predicts photos left out better.
    SVBRDF_GCN_REFINE_AUTO = 0,
    /// Nothing: the stated light exactly.
    SVBRDF_GCN_REFINE_NONE = 1,
    /// A factor on the stated light of each photo.
    SVBRDF_GCN_REFINE_LIGHT = 2,
    /// That, and the position of camera and light, which move together.
    SVBRDF_GCN_REFINE_ALL = 3,
}

/// How stored pixel values relate to linear radiance. It is always stated, never guessed.
#[repr(i32)]
pub enum svbrdf_gcn_transfer {
    /// Not given: what the capture on disk states. Pixels from the host need one of the others.
    SVBRDF_GCN_TRANSFER_FROM_CAPTURE = -1,
    /// stored = linear^(1/2.2).
    SVBRDF_GCN_TRANSFER_GAMMA22 = 0,
    /// The piecewise curve of IEC 61966-2-1.
    SVBRDF_GCN_TRANSFER_SRGB = 1,
    /// stored = linear.
    SVBRDF_GCN_TRANSFER_LINEAR = 2,
}

/// Primaries of linear colours.
#[repr(i32)]
pub enum svbrdf_gcn_color_space {
    /// Not given: what the capture on disk states, else Rec. 709.
    SVBRDF_GCN_COLOR_SPACE_FROM_CAPTURE = -1,
    /// The primaries of Rec. 709 and sRGB. Maps in memory, renderings and photos as the fit sees them are in these.
    SVBRDF_GCN_COLOR_SPACE_REC709 = 0,
    /// ACEScg.
    SVBRDF_GCN_COLOR_SPACE_ACESCG = 1,
}

/// The program a material is exported for.
#[repr(i32)]
pub enum svbrdf_gcn_export_target {
    /// A `.mtlx` document with an OpenPBR surface, and 16-bit PNGs.
    SVBRDF_GCN_EXPORT_MATERIALX = 0,
    /// A `.gltf` with a plane to look at, KHR_materials_specular, and 8-bit PNGs.
    SVBRDF_GCN_EXPORT_GLTF = 1,
    /// The maps of Blender's Principled BSDF as 16-bit PNGs.
    SVBRDF_GCN_EXPORT_PRINCIPLED = 2,
    /// Base colour, occlusion-roughness-metallic, specular and normal as PNGs for Unreal.
    SVBRDF_GCN_EXPORT_UNREAL = 3,
}

/// Which way green points in exported normal maps.
#[repr(i32)]
pub enum svbrdf_gcn_normals {
    /// As the target has it by itself.
    SVBRDF_GCN_NORMALS_OF_TARGET = -1,
    /// Up: +y.
    SVBRDF_GCN_NORMALS_OPENGL = 0,
    /// Down: -y.
    SVBRDF_GCN_NORMALS_DIRECTX = 1,
}

/// The image format of written maps.
#[repr(i32)]
pub enum svbrdf_gcn_format {
    /// OpenEXR with half floats, everything linear.
    SVBRDF_GCN_FORMAT_EXR = 0,
    /// PNG with 16 bits: albedos sRGB-encoded, the rest as data.
    SVBRDF_GCN_FORMAT_PNG16 = 1,
    /// TIFF with 32-bit floats, everything linear; loses nothing.
    SVBRDF_GCN_FORMAT_TIFF = 2,
}

/// Options of a fit; the names are those of the command line, where the photos and the files have theirs too (see
/// `svbrdf_gcn_capture_options` and `svbrdf_gcn_save_options`). Always fill it with `svbrdf_gcn_options_init` first.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct svbrdf_gcn_options {
    /// `sizeof(svbrdf_gcn_options)`.
    pub struct_size: usize,
    /// A `svbrdf_gcn_preset`; balanced by default.
    pub preset: i32,
    /// A `svbrdf_gcn_method`; auto by default.
    pub method: i32,
    /// UTF-8 path of other weights than those built in (safetensors), for those who load no model: only the network that this capture takes is read. NULL by
    /// default; give this or a model, not both.
    pub weights: *const c_char,
    /// Steps on the latent code; -1, the default: the preset's.
    pub latent_steps: i64,
    /// Steps on the adapters; -1, the default: the preset's.
    pub adapter_steps: i64,
    /// Steps on the maps themselves; -1, the default: the preset's.
    pub direct_steps: i64,
    /// Most bytes the run may use, photos and weights included; -1, the default: three quarters of the free memory beside these.
    pub max_memory: i64,
    /// Seed of everything random; 0 by default. Same seed, threads and CPU: same bits.
    pub seed: u64,
    /// Threads; -1, the default: all the machine offers.
    pub threads: i32,
    /// 1, the default: a stage stops when its loss has flattened; 0: it takes every step.
    pub early_stop: i32,
    /// Called with the progress, on the thread that called `svbrdf_gcn_fit_material`; NULL, the default: nobody is told.
    pub progress: svbrdf_gcn_progress_fn,
    /// Handed to `progress` as it is.
    pub progress_user_data: *mut c_void,
    /// Stops the run from another thread; NULL, the default: nothing does. It has to live until the fit returns.
    pub cancel: *const svbrdf_gcn_cancel_token,
    /// Steps of the per-pixel finish; -1, the default: the preset's; 0: none.
    pub finish_steps: i64,
    /// A `svbrdf_gcn_reflectance`; auto by default. A network of the paper's form takes auto alone.
    pub reflectance: i32,
    /// A `svbrdf_gcn_refine`; auto by default.
    pub refine: i32,
}

impl SizeFirst for svbrdf_gcn_options {
    const NAME: &'static str = "svbrdf_gcn_options";

    fn defaults() -> Self {
        Self {
            struct_size: size_of::<Self>(),
            preset: SVBRDF_GCN_PRESET_BALANCED as i32,
            method: SVBRDF_GCN_METHOD_AUTO as i32,
            weights: ptr::null(),
            latent_steps: -1,
            adapter_steps: -1,
            direct_steps: -1,
            finish_steps: -1,
            max_memory: -1,
            seed: 0,
            threads: -1,
            early_stop: 1,
            progress: None,
            progress_user_data: ptr::null_mut(),
            cancel: ptr::null(),
            reflectance: SVBRDF_GCN_REFLECTANCE_AUTO as i32,
            refine: SVBRDF_GCN_REFINE_AUTO as i32,
        }
    }
}

impl svbrdf_gcn_options {
    pub(crate) fn fit_options(&self, cancel: CancelToken) -> Result<FitOptions> {
        let preset = [
            (SVBRDF_GCN_PRESET_DRAFT as i32, Preset::Draft),
            (SVBRDF_GCN_PRESET_BALANCED as i32, Preset::Balanced),
            (SVBRDF_GCN_PRESET_HIGH as i32, Preset::High),
        ];
        let method = [
            (SVBRDF_GCN_METHOD_AUTO as i32, Method::Auto),
            (SVBRDF_GCN_METHOD_NETWORK as i32, Method::Network),
            (SVBRDF_GCN_METHOD_DIRECT as i32, Method::Direct),
        ];
        let reflectance = [
            (SVBRDF_GCN_REFLECTANCE_AUTO as i32, Reflectance::Auto),
            (SVBRDF_GCN_REFLECTANCE_DIFFUSE as i32, Reflectance::Diffuse),
            (SVBRDF_GCN_REFLECTANCE_DIELECTRIC as i32, Reflectance::Dielectric),
            (SVBRDF_GCN_REFLECTANCE_ISOTROPIC as i32, Reflectance::Isotropic),
            (SVBRDF_GCN_REFLECTANCE_ANISOTROPIC as i32, Reflectance::Anisotropic),
        ];
        let refine = [
            (SVBRDF_GCN_REFINE_AUTO as i32, Refine::Auto),
            (SVBRDF_GCN_REFINE_NONE as i32, Refine::None),
            (SVBRDF_GCN_REFINE_LIGHT as i32, Refine::Light),
            (SVBRDF_GCN_REFINE_ALL as i32, Refine::All),
        ];
        let mut options = FitOptions::preset(choose("preset", self.preset, &preset)?)
            .method(choose("method", self.method, &method)?)
            .reflectance(choose("reflectance", self.reflectance, &reflectance)?)
            .refine(choose("refine", self.refine, &refine)?)
            .seed(self.seed)
            .cancel(cancel);
        options.latent_steps = given("latent_steps", self.latent_steps)?;
        options.adapter_steps = given("adapter_steps", self.adapter_steps)?;
        options.direct_steps = given("direct_steps", self.direct_steps)?;
        options.finish_steps = given("finish_steps", self.finish_steps)?;
        options.max_memory = given("max_memory", self.max_memory)?;
        options.threads = given("threads", self.threads.into())?;
        options.early_stop = Some(choose("early_stop", self.early_stop, &[(0, false), (1, true)])?);
        Ok(options)
    }
}

/// Fills the options of a fit with their defaults. `struct_size` is `sizeof(svbrdf_gcn_options)`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn svbrdf_gcn_options_init(
    options: *mut svbrdf_gcn_options,
    struct_size: usize,
) -> svbrdf_gcn_status {
    // SAFETY: `options` has `struct_size` bytes, says the caller.
    unsafe { init("options", options, struct_size) }
}

/// How photos are read. Always fill it with `svbrdf_gcn_capture_options_init` first.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct svbrdf_gcn_capture_options {
    /// `sizeof(svbrdf_gcn_capture_options)`.
    pub struct_size: usize,
    /// Photos whose longer side is above this are resampled by area, in linear light, and so are the maps; -1, the default: none are.
    pub size: i64,
    /// Only these photos of a capture on disk, counted from 0, in this order; NULL, the default: all. Borrowed for the call.
    pub views: *const usize,
    /// How many `views` there are.
    pub view_count: usize,
    /// A `svbrdf_gcn_transfer`. By default what the capture on disk states; pixels from the host need it.
    pub transfer: i32,
    /// The stored value at which float pixels from the host are saturated; 0, the default: none are. Integers are from 98 % of their top code on.
    /// Captures on disk state their own.
    pub white_level: f32,
    /// A `svbrdf_gcn_color_space`: that of linear photos and of their `light_intensity`; both are converted to Rec. 709. By default what the capture
    /// on disk states, Rec. 709 for pixels from the host.
    pub color_space: i32,
    /// 1: photos on disk are read as if their files held no colour profiles and said nothing else of their colours; 0, the default: what they say
    /// counts where nothing states a `color_space`, with a warning (docs/color.md).
    pub ignore_profiles: i32,
    /// Stops the reading from another thread, also while a photo is decoded: it then returns `SVBRDF_GCN_CANCELLED`. NULL, the default: nothing does. It has
    /// to live until the call with these options returns; a capture made for pixels of the host keeps it in mind for the photos that are added.
    pub cancel: *const svbrdf_gcn_cancel_token,
    /// Most bytes the run may use, from the reading of photos on; -1, the default: three quarters of the free memory. What photos need is known from
    /// their files' headers, before any is decoded: `SVBRDF_GCN_ERR_OUT_OF_MEMORY` if it is more. Photos of the host count as they are kept.
    pub max_memory: i64,
    /// RGB intensity of the light of every photo, as in `svbrdf_gcn_shot`, in place of what the capture on disk states, or of what is chosen for one photo alone; three
    /// zeros, the default: not given. Photos of the host have theirs in their shots.
    pub light_intensity: [f64; 3],
}

impl SizeFirst for svbrdf_gcn_capture_options {
    const NAME: &'static str = "svbrdf_gcn_capture_options";

    fn defaults() -> Self {
        Self {
            struct_size: size_of::<Self>(),
            size: -1,
            views: ptr::null(),
            view_count: 0,
            transfer: SVBRDF_GCN_TRANSFER_FROM_CAPTURE as i32,
            white_level: 0.0,
            color_space: SVBRDF_GCN_COLOR_SPACE_FROM_CAPTURE as i32,
            ignore_profiles: 0,
            cancel: ptr::null(),
            max_memory: -1,
            light_intensity: [0.0; 3],
        }
    }
}

impl svbrdf_gcn_capture_options {
    /// # Safety
    /// `views` is NULL or has `view_count` numbers; `cancel` is NULL or a living token.
    pub(crate) unsafe fn capture_options(&self) -> Result<CaptureOptions> {
        // SAFETY: NULL or a living token, says the caller.
        let mut options = CaptureOptions::new().cancel(unsafe { token_or_new(self.cancel) });
        options.size = given("size", self.size)?;
        options.max_memory = given("max_memory", self.max_memory)?;
        options.light_intensity = (self.light_intensity != [0.0; 3]).then_some(self.light_intensity);
        if self.view_count > MAX_PHOTOS {
            return Err(Failure::invalid(
                "view_count",
                format!("expected at most {MAX_PHOTOS}, got {}", self.view_count),
            ));
        }
        options.views = match (self.views.is_null(), self.view_count) {
            (true, 0) => None,
            (true, _) => return Err(Failure::null("views")),
            // SAFETY: as many as the caller said there are.
            (false, count) => Some((0..count).map(|i| unsafe { self.views.add(i).read_unaligned() }).collect()),
        };
        options.color_space = choose(
            "color_space",
            self.color_space,
            &[
                (SVBRDF_GCN_COLOR_SPACE_FROM_CAPTURE as i32, None),
                (SVBRDF_GCN_COLOR_SPACE_REC709 as i32, Some(ColorSpace::Rec709)),
                (SVBRDF_GCN_COLOR_SPACE_ACESCG as i32, Some(ColorSpace::AcesCg)),
            ],
        )?;
        options.ignore_profiles = choose("ignore_profiles", self.ignore_profiles, &[(0, false), (1, true)])?;
        options.transfer = choose(
            "transfer",
            self.transfer,
            &[
                (SVBRDF_GCN_TRANSFER_FROM_CAPTURE as i32, None),
                (SVBRDF_GCN_TRANSFER_GAMMA22 as i32, Some(Transfer::Gamma22)),
                (SVBRDF_GCN_TRANSFER_SRGB as i32, Some(Transfer::Srgb)),
                (SVBRDF_GCN_TRANSFER_LINEAR as i32, Some(Transfer::Linear)),
            ],
        )?;
        Ok(options)
    }
}

/// Fills capture options with their defaults. `struct_size` is `sizeof(svbrdf_gcn_capture_options)`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn svbrdf_gcn_capture_options_init(
    options: *mut svbrdf_gcn_capture_options,
    struct_size: usize,
) -> svbrdf_gcn_status {
    // SAFETY: `options` has `struct_size` bytes, says the caller.
    unsafe { init("options", options, struct_size) }
}

/// How photos of a printed sheet, or photos of which the patch's corners are known, become a capture; lengths are in millimetres. Always fill it with `svbrdf_gcn_acquire_options_init` first.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct svbrdf_gcn_acquire_options {
    /// `sizeof(svbrdf_gcn_acquire_options)`.
    pub struct_size: usize,
    /// Width of the window of our own sheet (`svbrdf-gcn sheet`); 100 by default.
    pub window: f64,
    /// The photos show the frame of svbrdf-diff-renderer instead, this wide from outer edge to outer edge; 0, the default: they do not.
    pub frame_width: f64,
    /// Length of the sheet's bar of 100 mm as it was printed; 100 by default.
    pub printed_bar: f64,
    /// How far the sample lies below the sheet's face; 0 by default, negative above it.
    pub depth: f64,
    /// Where the flash is, seen from the lens: to the right and up in photos as they were taken, before they were turned upright; at the lens by default.
    pub light_offset: [f64; 2],
    /// 1: where the flash is is found from the paper; 0, the default: it is where `light_offset` says.
    pub find_light_offset: i32,
    /// UTF-8 path of a photo of the sheet without flash, exposed as the others: what it shows is subtracted. NULL, the default: there is none.
    pub dark_photo_utf8: *const c_char,
    /// Diffuse albedo of the paper; 0.8 by default.
    pub paper_white: f64,
    /// Side of the rectified photos in pixels, 16 to 16384; -1, the default: 1024. They are never finer than the photos.
    pub size: i64,
    /// Most bytes the work may use; -1, the default: three quarters of the free memory.
    pub max_memory: i64,
    /// Called with the progress, on the thread that called `svbrdf_gcn_acquire`; NULL, the default: nobody is told.
    pub progress: svbrdf_gcn_progress_fn,
    /// Handed to `progress` as it is.
    pub progress_user_data: *mut c_void,
    /// Stops the work from another thread; NULL, the default: nothing does. It has to live until the call returns.
    pub cancel: *const svbrdf_gcn_cancel_token,
    /// There is no sheet: eight numbers for each photo, the corners of the sample's square patch as x, y in pixels of the photo as viewers show it, from the upper left on
    /// clockwise. NULL, the default: photos show a sheet. What is said of a sheet does not count beside them.
    pub corners: *const f64,
    /// Width of the patch whose corners are given; 0 by default.
    pub patch_width: f64,
}

impl SizeFirst for svbrdf_gcn_acquire_options {
    const NAME: &'static str = "svbrdf_gcn_acquire_options";

    fn defaults() -> Self {
        Self {
            struct_size: size_of::<Self>(),
            window: 100.0,
            frame_width: 0.0,
            printed_bar: 100.0,
            depth: 0.0,
            light_offset: [0.0; 2],
            find_light_offset: 0,
            dark_photo_utf8: ptr::null(),
            paper_white: 0.8,
            size: -1,
            max_memory: -1,
            progress: None,
            progress_user_data: ptr::null_mut(),
            cancel: ptr::null(),
            corners: ptr::null(),
            patch_width: 0.0,
        }
    }
}

impl svbrdf_gcn_acquire_options {
    /// # Safety
    /// `dark_photo_utf8` is NULL or a NUL-terminated string, `corners` NULL or eight numbers for each of the `photos`.
    pub(crate) unsafe fn acquire_options(&self, photos: usize, cancel: CancelToken) -> Result<AcquireOptions> {
        let mut options = if self.corners.is_null() {
            if self.patch_width != 0.0 {
                return Err(Failure::invalid(
                    "patch_width",
                    format!(
                        "is that of the patch whose corners are given: expected 0 without corners, got {}",
                        self.patch_width
                    ),
                ));
            }
            let sheet = if self.frame_width == 0.0 { Sheet::new(self.window) } else { Sheet::tags16(self.frame_width) };
            AcquireOptions::new(sheet?.with_printed_bar(self.printed_bar)?)
        } else {
            // SAFETY: the caller's word.
            let photo = |i: usize| unsafe { self.corners.cast::<[[f64; 2]; 4]>().add(i).read_unaligned() };
            AcquireOptions::of_corners(Corners::new(self.patch_width, (0..photos).map(photo).collect())?)
        };
        options.depth = self.depth;
        let is_found = choose("find_light_offset", self.find_light_offset, &[(0, false), (1, true)])?;
        options.light_offset = (!is_found).then_some(self.light_offset);
        // SAFETY: the caller's word.
        options.dark = unsafe { text("dark_photo_utf8", self.dark_photo_utf8) }?.map(Into::into);
        options.paper_white = self.paper_white;
        options.size = given("size", self.size)?;
        options.max_memory = given("max_memory", self.max_memory)?;
        options.cancel = cancel;
        Ok(options)
    }
}

/// Fills acquire options with their defaults. `struct_size` is `sizeof(svbrdf_gcn_acquire_options)`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn svbrdf_gcn_acquire_options_init(
    options: *mut svbrdf_gcn_acquire_options,
    struct_size: usize,
) -> svbrdf_gcn_status {
    // SAFETY: `options` has `struct_size` bytes, says the caller.
    unsafe { init("options", options, struct_size) }
}

/// Where camera and light stood for a photo, in the capture's length unit: the sample is centred at the origin in the plane z = 0, x right,
/// y up, z towards the camera. Always fill it with `svbrdf_gcn_shot_init` first.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct svbrdf_gcn_shot {
    /// `sizeof(svbrdf_gcn_shot)`.
    pub struct_size: usize,
    /// What messages call the photo, UTF-8; NULL, the default: "photo" and its number. Borrowed for the call.
    pub name: *const c_char,
    /// Position of the camera, z above 0.
    pub camera: [f64; 3],
    /// Position of the point light, z above 0; that of the camera for a flash beside the lens.
    pub light: [f64; 3],
    /// RGB intensity, in photo units times length squared: a white diffuse patch that faces the light at distance r has the radiance
    /// `light_intensity / (pi r^2)`.
    pub light_intensity: [f64; 3],
}

impl SizeFirst for svbrdf_gcn_shot {
    const NAME: &'static str = "svbrdf_gcn_shot";

    fn defaults() -> Self {
        Self {
            struct_size: size_of::<Self>(),
            name: ptr::null(),
            camera: [0.0; 3],
            light: [0.0; 3],
            light_intensity: [0.0; 3],
        }
    }
}

impl svbrdf_gcn_shot {
    pub(crate) fn shot(&self) -> Shot {
        Shot { camera: self.camera, light: self.light, light_intensity: self.light_intensity }
    }

    pub(crate) fn from_shot(shot: &Shot) -> Self {
        let Shot { camera, light, light_intensity } = *shot;
        Self { camera, light, light_intensity, ..Self::defaults() }
    }

    /// # Safety
    /// `name` is NULL or a NUL-terminated string.
    pub(crate) unsafe fn name(&self, number: usize) -> Result<String> {
        // SAFETY: the caller's word.
        let name = unsafe { text("shot.name", self.name) }?;
        Ok(name.map_or_else(|| format!("photo {number}"), str::to_owned))
    }
}

/// Sets `struct_size` and makes everything else 0; the rest has to be filled in. `struct_size` is `sizeof(svbrdf_gcn_shot)`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn svbrdf_gcn_shot_init(shot: *mut svbrdf_gcn_shot, struct_size: usize) -> svbrdf_gcn_status {
    // SAFETY: `shot` has `struct_size` bytes, says the caller.
    unsafe { init("shot", shot, struct_size) }
}

/// How a material is written. Always fill it with `svbrdf_gcn_save_options_init` first.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct svbrdf_gcn_save_options {
    /// `sizeof(svbrdf_gcn_save_options)`.
    pub struct_size: usize,
    /// A `svbrdf_gcn_format`; OpenEXR by default.
    pub format: i32,
    /// A `svbrdf_gcn_color_space`: that of the albedos in files that are linear; Rec. 709 by default.
    pub color_space: i32,
}

impl SizeFirst for svbrdf_gcn_save_options {
    const NAME: &'static str = "svbrdf_gcn_save_options";

    fn defaults() -> Self {
        Self {
            struct_size: size_of::<Self>(),
            format: SVBRDF_GCN_FORMAT_EXR as i32,
            color_space: SVBRDF_GCN_COLOR_SPACE_REC709 as i32,
        }
    }
}

impl svbrdf_gcn_save_options {
    pub(crate) fn save_options(&self) -> Result<SaveOptions> {
        let format = choose(
            "format",
            self.format,
            &[
                (SVBRDF_GCN_FORMAT_EXR as i32, MaterialFormat::Exr),
                (SVBRDF_GCN_FORMAT_PNG16 as i32, MaterialFormat::Png16),
                (SVBRDF_GCN_FORMAT_TIFF as i32, MaterialFormat::Tiff),
            ],
        )?;
        let color_space = choose(
            "color_space",
            self.color_space,
            &[
                (SVBRDF_GCN_COLOR_SPACE_REC709 as i32, ColorSpace::Rec709),
                (SVBRDF_GCN_COLOR_SPACE_ACESCG as i32, ColorSpace::AcesCg),
            ],
        )?;
        Ok(SaveOptions::new(format).color_space(color_space))
    }
}

/// Fills save options with their defaults. `struct_size` is `sizeof(svbrdf_gcn_save_options)`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn svbrdf_gcn_save_options_init(
    options: *mut svbrdf_gcn_save_options,
    struct_size: usize,
) -> svbrdf_gcn_status {
    // SAFETY: `options` has `struct_size` bytes, says the caller.
    unsafe { init("options", options, struct_size) }
}

/// How a material is exported. Always fill it with `svbrdf_gcn_export_options_init` first, then say the target.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct svbrdf_gcn_export_options {
    /// `sizeof(svbrdf_gcn_export_options)`.
    pub struct_size: usize,
    /// A `svbrdf_gcn_export_target`; MaterialX by default.
    pub target: i32,
    /// A `svbrdf_gcn_normals`; the target's own convention by default. MaterialX and glTF define theirs.
    pub normals: i32,
    /// What the material is called in the files and in their names: up to 64 letters, digits and underscores, a letter first. NULL, the default: "material".
    pub name: *const c_char,
    /// 1, the default: the tilt of the whole surface is taken out of its normals, so that tiles of it make a plane; 0: it stays.
    pub level: i32,
}

impl SizeFirst for svbrdf_gcn_export_options {
    const NAME: &'static str = "svbrdf_gcn_export_options";

    fn defaults() -> Self {
        Self {
            struct_size: size_of::<Self>(),
            target: SVBRDF_GCN_EXPORT_MATERIALX as i32,
            normals: SVBRDF_GCN_NORMALS_OF_TARGET as i32,
            name: ptr::null(),
            level: 1,
        }
    }
}

impl svbrdf_gcn_export_options {
    /// # Safety
    /// `name` is NULL or a NUL-terminated string.
    pub(crate) unsafe fn export_options(&self) -> Result<ExportOptions> {
        let target = choose(
            "target",
            self.target,
            &[
                (SVBRDF_GCN_EXPORT_MATERIALX as i32, ExportTarget::MaterialX),
                (SVBRDF_GCN_EXPORT_GLTF as i32, ExportTarget::Gltf),
                (SVBRDF_GCN_EXPORT_PRINCIPLED as i32, ExportTarget::Principled),
                (SVBRDF_GCN_EXPORT_UNREAL as i32, ExportTarget::Unreal),
            ],
        )?;
        let mut options = ExportOptions::new(target);
        options.normals = choose(
            "normals",
            self.normals,
            &[
                (SVBRDF_GCN_NORMALS_OF_TARGET as i32, None),
                (SVBRDF_GCN_NORMALS_OPENGL as i32, Some(NormalConvention::OpenGl)),
                (SVBRDF_GCN_NORMALS_DIRECTX as i32, Some(NormalConvention::DirectX)),
            ],
        )?;
        options.level = choose("level", self.level, &[(0, false), (1, true)])?;
        // SAFETY: the caller's word.
        if let Some(name) = unsafe { text("name", self.name) }? {
            options = options.name(name);
        }
        Ok(options)
    }
}

/// Fills export options with their defaults. `struct_size` is `sizeof(svbrdf_gcn_export_options)`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn svbrdf_gcn_export_options_init(
    options: *mut svbrdf_gcn_export_options,
    struct_size: usize,
) -> svbrdf_gcn_status {
    // SAFETY: `options` has `struct_size` bytes, says the caller.
    unsafe { init("options", options, struct_size) }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    /// A struct of a later release.
    #[repr(C)]
    struct Longer {
        options: svbrdf_gcn_save_options,
        more: u64,
    }

    #[test]
    fn longer_structs_are_taken_and_filled() {
        let mut longer = Longer { options: svbrdf_gcn_save_options::defaults(), more: u64::MAX };
        // SAFETY: the struct has the size stated.
        let status = unsafe { svbrdf_gcn_save_options_init(&raw mut longer.options, size_of::<Longer>()) };
        assert_eq!((status, longer.more, longer.options.struct_size), (SVBRDF_GCN_OK, 0, size_of::<Longer>()));
        longer.options.format = SVBRDF_GCN_FORMAT_TIFF as i32;
        // SAFETY: likewise.
        let ours = unsafe { read("options", &raw const longer.options) }.unwrap();
        assert_eq!(ours.save_options().unwrap().format, MaterialFormat::Tiff);
    }

    #[test]
    fn sizes_that_no_release_had_are_errors() {
        let mut options = svbrdf_gcn_options::defaults();
        for size in [0, 8, size_of::<svbrdf_gcn_options>() - 1, MAX_STRUCT_SIZE + 1, usize::MAX] {
            options.struct_size = size;
            // SAFETY: nothing is read but the size.
            let failure = unsafe { read("options", &raw const options) }.err().unwrap();
            assert_eq!(failure.status, SVBRDF_GCN_ERR_STRUCT_SIZE);
            assert!(failure.message.contains(&size.to_string()), "{}", failure.message);
        }
    }

    #[test]
    fn defaults_are_the_cores() {
        let ours = svbrdf_gcn_options::defaults().fit_options(CancelToken::new()).unwrap();
        let core = FitOptions::default().early_stop(true);
        assert_eq!(format!("{ours:?}"), format!("{core:?}"));
        let defaults = svbrdf_gcn_capture_options::defaults();
        // SAFETY: there are no views and no token.
        let ours = unsafe { defaults.capture_options() }.unwrap();
        assert_eq!(format!("{ours:?}"), format!("{:?}", CaptureOptions::new()));
        assert_eq!(svbrdf_gcn_save_options::defaults().save_options().unwrap(), SaveOptions::default());
        // SAFETY: there is no photo without flash, and there are no corners.
        let ours = unsafe { svbrdf_gcn_acquire_options::defaults().acquire_options(0, CancelToken::new()) }.unwrap();
        let core = AcquireOptions::new(Sheet::new(100.0).unwrap());
        assert_eq!(format!("{ours:?}"), format!("{core:?}"));
    }

    #[test]
    fn numbers_out_of_range_are_named() {
        let options = svbrdf_gcn_options { threads: -2, ..svbrdf_gcn_options::defaults() };
        let message = options.fit_options(CancelToken::new()).unwrap_err().message;
        assert!(message.starts_with("threads:") && message.ends_with("got -2"), "{message}");
        let options = svbrdf_gcn_options { preset: 3, ..svbrdf_gcn_options::defaults() };
        let message = options.fit_options(CancelToken::new()).unwrap_err().message;
        assert_eq!(message, "preset: expected one of 0, 1, 2, got 3");
    }

    proptest! {
        /// Options of random bytes (pointers aside) are taken or refused.
        #[test]
        fn any_options(bytes in proptest::collection::vec(any::<u8>(), size_of::<svbrdf_gcn_options>()), small in any::<bool>()) {
            let mut options = svbrdf_gcn_options::defaults();
            let mut capture = svbrdf_gcn_capture_options::defaults();
            let mut save = svbrdf_gcn_save_options::defaults();
            let mut export = svbrdf_gcn_export_options::defaults();
            let mut acquire = svbrdf_gcn_acquire_options::defaults();
            /// # Safety
            /// Any bits are a `T`.
            unsafe fn fill<T>(value: &mut T, bytes: &[u8]) {
                // SAFETY: the caller's word, and no more bytes than there are.
                unsafe { ptr::copy_nonoverlapping(bytes.as_ptr(), ptr::from_mut(value).cast::<u8>(), size_of::<T>().min(bytes.len())) };
            }
            // Small numbers are more often good.
            let bytes: Vec<u8> = bytes.iter().enumerate().map(|(i, byte)| if small { if i % 4 == 0 { byte % 3 } else { 0 } } else { *byte }).collect();
            // SAFETY: integers, floats and pointers take any bits; the pointers are not followed, for they are replaced.
            unsafe {
                fill(&mut options, &bytes);
                fill(&mut capture, &bytes);
                fill(&mut save, &bytes);
                fill(&mut export, &bytes);
                fill(&mut acquire, &bytes);
            }
            (capture.views, capture.cancel, export.name) = (ptr::null(), ptr::null(), ptr::null());
            (acquire.dark_photo_utf8, acquire.corners) = (ptr::null(), ptr::null());
            let fit = options.fit_options(CancelToken::new());
            if let Ok(fit) = fit {
                prop_assert_eq!(fit.seed, options.seed);
            }
            // SAFETY: there are no views, no token, no name, no photo without flash and no corners.
            let others = unsafe {
                (capture.capture_options(), export.export_options(), acquire.acquire_options(0, CancelToken::new()))
            };
            drop((others, save.save_options()));
        }
    }
}
