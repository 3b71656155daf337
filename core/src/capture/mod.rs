//! A capture: flash photos of one nearly flat sample, and where camera and light stood for each.
//!
//! Frame: the sample is centred at the origin in the plane z = 0, x right, y up (image row 0 is +y), z towards the camera.
//! Pixel (row i, column j) of an H x W image lies at `x = ((j + 0.5) / W - 0.5) * patch_size`,
//! `y = -((i + 0.5) / H - 0.5) * patch_size * H / W`. Positions and `patch_size` (the width) share one length unit.

mod acquired;
mod assumed;
mod evaluation;
mod layout;

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, PoisonError};

use crate::cancel::CancelToken;
use crate::color::{ColorSpace, Transfer, apply_to_image};
use crate::error::{Error, Result, printable};
use crate::image::Image;
use crate::io::describe::is_image;
use crate::io::profile::{Decoding, FileColors, Stated};
use crate::io::resize::{fit_size, shrink};
use crate::io::{Demand, Pixels, RowReader, Samples, demand, read_stored};
use crate::render::{Target, encode_radiance};
use crate::shot::Shot;
use crate::unit::Unit;
use crate::{memory, pool};

pub use acquired::{Acquired, AcquiredPhoto};
pub use assumed::Assumed;
pub(crate) use assumed::{BRIGHTEST_ALBEDO, brightest};
pub use evaluation::render_photo;
use layout::{Entry, Layout};

/// The most photos of a capture: no walk around a sample takes as many.
pub const MAX_PHOTOS: usize = 4096;

/// One photo.
#[derive(Clone, Debug, PartialEq)]
pub struct Photo {
    /// File name or a name given by the host, for messages.
    pub name: String,
    /// Positions and light.
    pub shot: Shot,
    /// Linear RGB (Rec. 709), (H, W, 3).
    pub image: Image,
    /// One byte per pixel; bit c is set where channel c stands at the encoding's upper end and only says "at least this bright".
    pub saturated: Vec<u8>,
}

impl Photo {
    /// The photo as the loss compares with it.
    ///
    /// # Errors
    /// As [`Target::new`]; [`Error::ShapeMismatch`] if the photo has not three channels.
    pub fn target(&self) -> Result<Target> {
        let image = &self.image;
        if image.channels() != 3 {
            return Err(Error::shape(self.name.as_str(), "3 channels", format!("{}", image.channels())));
        }
        let mut encoded = image.to_planar()?;
        encoded.iter_mut().for_each(|value| *value = encode_radiance(*value));
        Target::new(image.width(), image.height(), self.shot, &encoded, &self.saturated)
    }
}

/// Pixels of one photo in a host's memory, for [`Capture::from_photos`].
#[derive(Clone, Copy, Debug)]
pub struct PhotoPixels<'a> {
    /// What messages call the photo.
    pub name: &'a str,
    /// Positions and light.
    pub shot: Shot,
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// 1 (grey), 2 (grey, alpha), 3 (RGB) or 4 (RGB, alpha); alpha is ignored with a warning.
    pub channels: usize,
    /// Rows from the top, channels interleaved, encoded with the capture's transfer function.
    pub samples: Samples<'a>,
}

/// How a capture is read.
#[derive(Clone, Debug, Default)]
#[non_exhaustive]
pub struct CaptureOptions {
    /// The longer side of the photos after reading; see [`CaptureOptions::size`].
    pub size: Option<usize>,
    /// The photos to take; see [`CaptureOptions::views`].
    pub views: Option<Vec<usize>>,
    /// The light intensity; see [`CaptureOptions::light_intensity`].
    pub light_intensity: Option<[f64; 3]>,
    /// The transfer function; see [`CaptureOptions::transfer`].
    pub transfer: Option<Transfer>,
    /// The colour space of linear photos; see [`CaptureOptions::color_space`].
    pub color_space: Option<ColorSpace>,
    /// Whether colour profiles in files count for nothing; see [`CaptureOptions::ignore_profiles`].
    pub ignore_profiles: bool,
    /// Stops the reading from another thread.
    pub cancel: CancelToken,
    /// The most bytes of the run; see [`CaptureOptions::max_memory`].
    pub max_memory: Option<u64>,
    /// Bytes of them that are taken; see [`CaptureOptions::in_use`].
    pub in_use: u64,
}

impl CaptureOptions {
    /// All photos, at their own size, with the transfer function of the capture.
    pub fn new() -> Self {
        Self::default()
    }

    /// Photos whose longer side is above `size` pixels are resampled by area, in linear light; smaller ones are never enlarged.
    pub fn size(mut self, size: usize) -> Self {
        self.size = Some(size);
        self
    }

    /// Only these photos, counted from 0, in this order; no others are opened.
    pub fn views(mut self, views: impl Into<Vec<usize>>) -> Self {
        self.views = Some(views.into());
        self
    }

    /// Replaces the light intensity of every photo.
    pub fn light_intensity(mut self, light_intensity: [f64; 3]) -> Self {
        self.light_intensity = Some(light_intensity);
        self
    }

    /// Replaces the transfer function that the capture states or its layout implies.
    pub fn transfer(mut self, transfer: Transfer) -> Self {
        self.transfer = Some(transfer);
        self
    }

    /// Replaces the colour space that the capture states for linear photos and their light intensity; [`ColorSpace::Rec709`] where it states none.
    ///
    /// Both are converted to linear Rec. 709. For photos in another transfer function [`ColorSpace::AcesCg`] says nothing, with a warning.
    /// A file that says something else of its colours is not believed, with a warning.
    pub fn color_space(mut self, color_space: ColorSpace) -> Self {
        self.color_space = Some(color_space);
        self
    }

    /// Reads photos as if their files said nothing of their colours.
    ///
    /// Without it, where neither the capture nor [`CaptureOptions::color_space`] states a colour space, photos are converted to linear Rec. 709
    /// by what their files say (ICC profiles, chunks of PNG, chromaticities of OpenEXR and TIFF, Adobe RGB in EXIF data), with a warning: wholly
    /// where the transfer function is [`Transfer::Srgb`], by their primaries where it is another that agrees with the file's.
    /// `light_intensity` stays what it is.
    pub fn ignore_profiles(mut self, ignore: bool) -> Self {
        self.ignore_profiles = ignore;
        self
    }

    /// Stops the reading once `token` is cancelled, also while a photo is decoded: it ends with [`Error::Cancelled`].
    pub fn cancel(mut self, token: CancelToken) -> Self {
        self.cancel = token;
        self
    }

    /// The most bytes that the run may use, the reading of photos included; three quarters of the free memory if not given.
    ///
    /// What photos need is known from the headers of their files, before any is decoded. Fewer are read at a time where all at once would need more.
    pub fn max_memory(mut self, bytes: u64) -> Self {
        self.max_memory = Some(bytes);
        self
    }

    /// Bytes that the run holds already and that count against [`CaptureOptions::max_memory`]: of photos read before, of a material.
    pub fn in_use(mut self, bytes: u64) -> Self {
        self.in_use = bytes;
        self
    }
}

/// How the stored values of a capture's photos become linear Rec. 709.
#[derive(Clone, Copy)]
struct Encoding {
    stated: Stated,
    /// The transfer function is what photos of the layout usually have; nobody states it.
    implied: bool,
    white_level: Option<f32>,
}

impl Encoding {
    /// What the options ask for, else what the capture states.
    fn new(
        transfer: Transfer,
        implied: bool,
        color_space: Option<ColorSpace>,
        white_level: Option<f32>,
        options: &CaptureOptions,
    ) -> Result<Self> {
        check_white_level(white_level)?;
        let stated = Stated {
            transfer: options.transfer.unwrap_or(transfer),
            color_space: options.color_space.or(color_space),
            ignore_profiles: options.ignore_profiles,
        };
        Ok(Self { stated, implied: implied && options.transfer.is_none(), white_level })
    }

    /// What holds for a photo of `samples`, and what is to be said of it.
    fn of_photo(self, samples: Samples<'_>) -> (Stated, Vec<String>) {
        let (mut stated, mut notes) = (self.stated, Vec::new());
        let name = stated.transfer.name();
        if self.implied && matches!(samples, Samples::F32(_)) {
            stated.transfer = Transfer::Linear;
            notes.push(format!(
                "photos of floats are linear: read as linear, not as {name}, which is usual in this layout"
            ));
        }
        if let (Some(ColorSpace::AcesCg), false) = (stated.color_space, stated.transfer == Transfer::Linear) {
            stated.color_space = None;
            notes.push(format!(
                "color_space acescg is for linear photos: those in {name} are rec709, or what their files say"
            ));
        }
        (stated, notes)
    }
}

/// Photos of one sample, all of the same size.
#[derive(Clone, Debug)]
pub struct Capture {
    photos: Vec<Photo>,
    patch_size: f64,
    transfer: Transfer,
    unit: Option<Unit>,
    assumed: Option<Assumed>,
    acquired: Option<Acquired>,
    warnings: Vec<String>,
    /// Estimated bytes at the peak of the reading.
    reading: u64,
}

impl PartialEq for Capture {
    /// Whether what was read is the same; what the reading took does not count.
    fn eq(&self, other: &Self) -> bool {
        let read = |c: &Self| (c.patch_size, c.transfer, c.assumed);
        read(self) == read(other)
            && self.unit == other.unit
            && self.acquired == other.acquired
            && self.photos == other.photos
            && self.warnings == other.warnings
    }
}

/// Bytes of a pixel of a mask: its picture, and what it says.
const MASK_BYTES: u64 = 3 + 1;

/// Bytes of a photo's pixel: linear RGB, and what is saturated.
const PIXEL_BYTES: u64 = 3 * 4 + 1;

impl Capture {
    /// Reads a capture: a folder in the layout of MaterialGAN and the paper (`0.png` or `00.png` ..., `camera_pos.txt`,
    /// `light_pos.txt`, `image_size.txt`, `light_power.txt`; gamma 2.2), a folder with a `capture.json` (which wins), a
    /// `capture.json` itself, or a JSON file of svbrdf-diff-renderer (gamma 2.2). `docs/captures.md` describes them.
    ///
    /// An image file is a capture of one photo, of which the rest is [`Assumed`], with warnings.
    ///
    /// # Errors
    /// As [`Capture::open_with`].
    ///
    /// # Example
    /// ```no_run
    /// use svbrdf_gcn::Capture;
    ///
    /// let capture = Capture::open("captures/wood")?;
    /// for warning in capture.warnings() {
    ///     eprintln!("{warning}");
    /// }
    /// let camera = capture.photos()[0].shot.camera;
    /// # Ok::<(), svbrdf_gcn::Error>(())
    /// ```
    pub fn open(path: impl AsRef<Path>) -> Result<Self> {
        Self::open_with(path, &CaptureOptions::default())
    }

    /// [`Capture::open`] with options.
    ///
    /// # Example
    /// ```no_run
    /// use svbrdf_gcn::{Capture, CaptureOptions, Transfer};
    ///
    /// let options = CaptureOptions::new().size(512).views([0, 2, 5]).transfer(Transfer::Srgb);
    /// let capture = Capture::open_with("captures/wood", &options)?;
    /// assert_eq!(capture.len(), 3);
    /// # Ok::<(), svbrdf_gcn::Error>(())
    /// ```
    ///
    /// # Errors
    /// [`Error::Io`] for files that are missing or broken, [`Error::UnsupportedFormat`] for layouts and image formats that are
    /// not read, [`Error::ShapeMismatch`] where counts or photo sizes differ, [`Error::InvalidArgument`] for values out of range:
    /// positions that are not in front of the sample, sizes and intensities that are not positive, views that do not exist.
    pub fn open_with(path: impl AsRef<Path>, options: &CaptureOptions) -> Result<Self> {
        let path = path.as_ref();
        if is_image(path) { Self::of_photo(path, options) } else { Self::read(Layout::read(path)?, options) }
    }

    /// A capture of one photo, of which nothing is known but its file.
    fn of_photo(path: &Path, options: &CaptureOptions) -> Result<Self> {
        if let Some(views) = &options.views {
            check_views(views, 1)?;
        }
        // Programs encode pictures in sRGB, and leave floats linear.
        let encoding = Encoding::new(Transfer::Srgb, true, None, None, options)?;
        let name = path.file_name().unwrap_or(path.as_os_str()).to_string_lossy().into_owned();
        let demand = |path: &&Path| demand(path, &options.cancel).ok();
        let load = |path: &&Path| {
            let stored = read_stored(path, &options.cancel)?;
            let assumed = Assumed::new(stored.width, stored.height, &stored.camera, options.light_intensity);
            let (pixels, colors) = (stored.pixels(), stored.colors.as_ref());
            let mut loaded = develop(&name, assumed.shot(), pixels, colors, None, encoding, options)?;
            loaded.notes.extend(assumed.notes(stored.camera.flash_fired));
            loaded.notes.extend(stored.notes);
            // A stated intensity was converted by its colour space.
            let light_intensity = loaded.photo.shot.light_intensity;
            let assumed = Assumed { light_intensity, ..assumed }.with_light_of(&loaded.photo.image);
            loaded.photo.shot = assumed.shot();
            Ok(Loaded { assumed: Some(assumed), ..loaded })
        };
        let (loaded, reading) = read_all(&[path], demand, load, options)?;
        let (width, height) = loaded[0].full_size;
        Self::assemble(loaded, Assumed::patch_size(width, height), None, options.size, reading)
    }

    /// A capture from image files and where camera and light stood for each; the rest as in [`Capture::from_photos`].
    ///
    /// # Errors
    /// As [`Capture::open_with`].
    ///
    /// # Example
    /// ```no_run
    /// use svbrdf_gcn::{Capture, CaptureOptions, Shot, Transfer};
    ///
    /// let shot = |x| Shot { camera: [x, 0.0, 20.0], light: [x, 0.0, 20.0], light_intensity: [1500.0; 3] };
    /// let files = [("left.jpg".into(), shot(-3.0)), ("right.jpg".into(), shot(3.0))];
    /// let capture = Capture::from_files(&files, 9.7, Transfer::Srgb, None, &CaptureOptions::new())?;
    /// # Ok::<(), svbrdf_gcn::Error>(())
    /// ```
    pub fn from_files(
        files: &[(PathBuf, Shot)],
        patch_size: f64,
        transfer: Transfer,
        white_level: Option<f32>,
        options: &CaptureOptions,
    ) -> Result<Self> {
        let entry = |(path, shot): &(PathBuf, Shot)| {
            let name = path.file_name().unwrap_or(path.as_os_str()).to_string_lossy().into_owned();
            Entry { name, path: path.clone(), shot: *shot, saturated: None }
        };
        let entries = files.iter().map(entry).collect();
        let (color_space, implied) = (None, false);
        let (unit, acquired) = (None, None);
        let layout = Layout { entries, patch_size, transfer, implied, color_space, unit, white_level, acquired };
        Self::read(layout, options)
    }

    fn read(layout: Layout, options: &CaptureOptions) -> Result<Self> {
        let Layout { entries, patch_size, transfer, implied, color_space, unit, white_level, acquired } = layout;
        let encoding = Encoding::new(transfer, implied, color_space, white_level, options)?;
        check_patch_size(patch_size)?;
        for entry in &entries {
            entry.shot.check(&entry.name)?;
        }
        let selected: Vec<_> = match &options.views {
            Some(views) => check_views(views, entries.len())?.iter().map(|&view| &entries[view]).collect(),
            None => entries.iter().collect(),
        };
        // Of what is no photo the reading says what is wrong.
        let demand = |entry: &&Entry| {
            let demand = demand(&entry.path, &options.cancel).ok()?;
            let mask = if entry.saturated.is_some() { MASK_BYTES * (demand.size.0 * demand.size.1) as u64 } else { 0 };
            Some(Demand { stored: demand.stored.saturating_add(mask), ..demand })
        };
        let load = |entry: &&Entry| {
            let stored = read_stored(&entry.path, &options.cancel)?;
            let (pixels, colors) = (stored.pixels(), stored.colors.as_ref());
            let mask = match &entry.saturated {
                Some(path) => Some(mask(path, pixels, &options.cancel)?),
                None => None,
            };
            let photo = develop(&entry.name, entry.shot, pixels, colors, mask.as_deref(), encoding, options)?;
            // Positions are stated for the picture as it is read.
            let turned = stored.camera.orientation.map(|turned| format!("orientation {turned} of the file applied"));
            Ok(Loaded { notes: photo.notes.into_iter().chain(turned).chain(stored.notes).collect(), ..photo })
        };
        let (loaded, reading) = read_all(&selected, demand, load, options)?;
        Ok(Self { acquired, ..Self::assemble(loaded, patch_size, unit, options.size, reading)? })
    }

    /// A capture from photos in memory, with the checks of [`Capture::open_with`].
    ///
    /// `patch_size` is the width of the patch. `white_level` is the stored value at which float samples are saturated; without
    /// it none are. Integer samples are saturated from 98 % of their top code on.
    ///
    /// # Errors
    /// As [`Capture::open_with`]; [`Error::ShapeMismatch`] if a photo's samples are not `width * height * channels` values.
    ///
    /// # Example
    /// ```
    /// use svbrdf_gcn::io::Samples;
    /// use svbrdf_gcn::{Capture, CaptureOptions, PhotoPixels, Shot, Transfer};
    ///
    /// let pixels = [255u8, 128, 0, 64, 64, 64];
    /// let shot = Shot { camera: [0.0, 0.0, 20.0], light: [1.0, 0.0, 20.0], light_intensity: [1500.0; 3] };
    /// let photo =
    ///     PhotoPixels { name: "left", shot, width: 2, height: 1, channels: 3, samples: Samples::U8(&pixels) };
    /// let capture = Capture::from_photos(&[photo], 9.7, Transfer::Srgb, None, &CaptureOptions::new())?;
    /// assert_eq!(capture.photos()[0].image.data()[0], 1.0);
    /// assert_eq!(capture.photos()[0].saturated, [0b001, 0]);
    /// # Ok::<(), svbrdf_gcn::Error>(())
    /// ```
    pub fn from_photos(
        photos: &[PhotoPixels<'_>],
        patch_size: f64,
        transfer: Transfer,
        white_level: Option<f32>,
        options: &CaptureOptions,
    ) -> Result<Self> {
        let encoding = Encoding::new(transfer, false, None, white_level, options)?;
        check_patch_size(patch_size)?;
        for photo in photos {
            photo.shot.check(photo.name)?;
            let expected = photo.width.checked_mul(photo.height).and_then(|n| n.checked_mul(photo.channels));
            if !(1..=4).contains(&photo.channels) || photo.samples.is_empty() || expected != Some(photo.samples.len()) {
                return Err(Error::shape(
                    photo.name,
                    format!("{} x {} pixels of {} channels, 1 to 4", photo.width, photo.height, photo.channels),
                    format!("{} values", photo.samples.len()),
                ));
            }
        }
        let selected: Vec<_> = match &options.views {
            Some(views) => check_views(views, photos.len())?.iter().map(|&view| &photos[view]).collect(),
            None => photos.iter().collect(),
        };
        // The host's pixels are its own.
        let demand = |photo: &&PhotoPixels<'_>| {
            let (size, colors) = ((photo.width, photo.height), if photo.channels >= 3 { 3 } else { 1 });
            Some(Demand { size, colors, stored: 0, decoding: 0 })
        };
        let load = |photo: &&PhotoPixels<'_>| {
            let PhotoPixels { name, shot, width, height, channels, samples } = **photo;
            let pixels = Pixels { width, height, channels, samples };
            develop(name, shot, pixels, None, None, encoding, options)
        };
        let (loaded, reading) = read_all(&selected, demand, load, options)?;
        Self::assemble(loaded, patch_size, None, options.size, reading)
    }

    /// A capture from photos that are linear Rec. 709 already; `transfer` says how they were stored before.
    ///
    /// # Errors
    /// As [`Capture::from_photos`].
    pub fn new(photos: Vec<Photo>, patch_size: f64, transfer: Transfer) -> Result<Self> {
        check_count(photos.len())?;
        check_patch_size(patch_size)?;
        for photo in &photos {
            photo.shot.check(&photo.name)?;
            if photo.image.channels() != 3 || photo.saturated.len() != photo.image.width() * photo.image.height() {
                return Err(Error::shape(
                    &photo.name,
                    "an RGB image and one saturation byte per pixel",
                    format!("{} channels, {} bytes", photo.image.channels(), photo.saturated.len()),
                ));
            }
            check_finite(&photo.name, photo.image.data(), 3 * photo.image.width())?;
        }
        let loaded = photos
            .into_iter()
            .map(|photo| {
                let full_size = (photo.image.width(), photo.image.height());
                Loaded { photo, transfer, full_size, assumed: None, notes: Vec::new() }
            })
            .collect();
        Self::assemble(loaded, patch_size, None, None, 0)
    }

    fn assemble(
        loaded: Vec<Loaded>,
        patch_size: f64,
        unit: Option<Unit>,
        size: Option<usize>,
        reading: u64,
    ) -> Result<Self> {
        let Some(first) = loaded.first() else {
            return Err(Error::invalid("capture", "expected at least one photo, got 0"));
        };
        let ((width, height), first_name, assumed) = (first.full_size, &first.photo.name, first.assumed);
        if let Some(other) = loaded.iter().find(|other| other.full_size != (width, height)) {
            return Err(Error::shape(
                &other.photo.name,
                format!("{width} x {height} pixels as {first_name} has"),
                format!("{} x {}", other.full_size.0, other.full_size.1),
            ));
        }
        // Only where a layout implies one do photos differ in it: by then some are encoded.
        let encoded = loaded.iter().map(|photo| photo.transfer).find(|&transfer| transfer != Transfer::Linear);
        let transfer = encoded.unwrap_or(Transfer::Linear);
        let mut warnings = Vec::new();
        if let Some(size) = size.filter(|&size| size > width.max(height)) {
            warnings.push(format!("size {size} asked for, photos of {width} x {height} are not enlarged"));
        }
        let mut notes: Vec<&String> = loaded.iter().flat_map(|photo| &photo.notes).collect();
        notes.sort();
        notes.dedup();
        for note in notes {
            let names: Vec<&str> = loaded
                .iter()
                .filter(|photo| photo.notes.contains(note))
                .map(|photo| photo.photo.name.as_str())
                .collect();
            warnings.push(printable(format_args!("{}: {note}", names.join(", "))));
        }
        let photos = loaded.into_iter().map(|loaded| loaded.photo).collect();
        Ok(Self { photos, patch_size, transfer, unit, assumed, acquired: None, warnings, reading })
    }

    /// Adds the photos of `other`, for hosts that hand them over one at a time.
    ///
    /// # Errors
    /// [`Error::ShapeMismatch`] if its photos have another size, [`Error::InvalidArgument`] if it has another `patch_size` or transfer
    /// function; `self` then stays as it was.
    pub fn append(&mut self, other: Self) -> Result<()> {
        if (other.width(), other.height()) != (self.width(), self.height()) {
            return Err(Error::shape(
                &other.photos[0].name,
                format!("{} x {} pixels as {} has", self.width(), self.height(), self.photos[0].name),
                format!("{} x {}", other.width(), other.height()),
            ));
        }
        if other.patch_size != self.patch_size {
            return Err(Error::invalid(
                "patch_size",
                format!("expected {}, got {}", self.patch_size, other.patch_size),
            ));
        }
        if other.transfer != self.transfer {
            let (expected, got) = (self.transfer.name(), other.transfer.name());
            return Err(Error::invalid("transfer", format!("expected {expected}, got {got}")));
        }
        check_count(self.photos.len() + other.photos.len())?;
        let new = other.warnings.into_iter().filter(|warning| !self.warnings.contains(warning)).collect::<Vec<_>>();
        self.warnings.extend(new);
        self.photos.extend(other.photos);
        self.reading = self.reading.max(other.reading);
        Ok(())
    }

    /// The photos.
    pub fn photos(&self) -> &[Photo] {
        &self.photos
    }

    /// How many photos there are; at least one.
    #[expect(clippy::len_without_is_empty, reason = "a capture is never empty")]
    pub fn len(&self) -> usize {
        self.photos.len()
    }

    /// Columns of every photo.
    pub fn width(&self) -> usize {
        self.photos[0].image.width()
    }

    /// Rows of every photo.
    pub fn height(&self) -> usize {
        self.photos[0].image.height()
    }

    /// Width of the patch in the capture's length unit; its height is `patch_size * height / width`.
    pub fn patch_size(&self) -> f64 {
        self.patch_size
    }

    /// Where the centre of a pixel lies in the plane z = 0, (x, y) in the unit of the positions.
    pub(crate) fn position(&self, row: usize, column: usize) -> [f64; 2] {
        let (width, height) = (self.width() as f64, self.height() as f64);
        let pitch = self.patch_size() / width;
        [(column as f64 + 0.5 - width / 2.0) * pitch, (height / 2.0 - row as f64 - 0.5) * pitch]
    }

    /// The transfer function the photos were decoded with.
    pub fn transfer(&self) -> Transfer {
        self.transfer
    }

    /// The length unit, where the capture states it.
    pub fn unit(&self) -> Option<&Unit> {
        self.unit.as_ref()
    }

    /// Bytes of its photos in memory.
    pub fn memory(&self) -> u64 {
        PIXEL_BYTES * (self.len() * self.width() * self.height()) as u64
    }

    /// Estimated bytes at the peak of the reading.
    pub(crate) fn reading_memory(&self) -> u64 {
        self.reading
    }

    /// The capture with its length unit named.
    pub(crate) fn with_unit(self, unit: Unit) -> Self {
        Self { unit: Some(unit), ..self }
    }

    /// The capture with what `acquire` says of it.
    pub(crate) fn with_acquired(self, acquired: Acquired) -> Self {
        Self { acquired: Some(acquired), ..self }
    }

    /// What `acquire` says of a capture that it made.
    pub fn acquired(&self) -> Option<&Acquired> {
        self.acquired.as_ref()
    }

    /// What was assumed, of one photo that came without a capture.
    pub fn assumed(&self) -> Option<&Assumed> {
        self.assumed.as_ref()
    }

    /// The capture of one photo under other assumptions.
    pub(crate) fn with_assumed(&self, assumed: Assumed) -> Result<Self> {
        let shot = assumed.shot();
        shot.check(&self.photos[0].name)?;
        let photos = self.photos.iter().map(|photo| Photo { shot, ..photo.clone() }).collect();
        Ok(Self { assumed: Some(assumed), ..self.with_photos(photos) })
    }

    /// What a user should know about how the capture was read.
    pub fn warnings(&self) -> &[String] {
        &self.warnings
    }

    /// The capture with only these photos, counted from 0, in this order.
    ///
    /// # Errors
    /// [`Error::InvalidArgument`] if `views` is empty, names a photo twice or one that does not exist.
    pub fn select(&self, views: &[usize]) -> Result<Self> {
        let photos = check_views(views, self.len())?.iter().map(|&view| self.photos[view].clone()).collect();
        Ok(self.with_photos(photos))
    }

    fn with_photos(&self, photos: Vec<Photo>) -> Self {
        let (unit, acquired, warnings) = (self.unit.clone(), self.acquired.clone(), self.warnings.clone());
        Self { photos, unit, acquired, warnings, ..*self }
    }
}

/// A photo, how it was encoded, its size before resampling, and what there is to say about how it was read.
struct Loaded {
    photo: Photo,
    transfer: Transfer,
    full_size: (usize, usize),
    /// What was assumed of a photo without a capture.
    assumed: Option<Assumed>,
    notes: Vec<String>,
}

/// Makes a linear photo of stored pixels: decodes, resamples as `options` say, expands grey, converts to Rec. 709, notes what is saturated.
///
/// `colors` is what the file says of its colours, `mask` which channels are saturated beside those that the values tell. A conversion mixes the channels: a pixel saturated in one is saturated in all then.
fn develop(
    name: &str,
    shot: Shot,
    pixels: Pixels<'_>,
    colors: Option<&FileColors>,
    mask: Option<&[u8]>,
    encoding: Encoding,
    options: &CaptureOptions,
) -> Result<Loaded> {
    let white_level = encoding.white_level;
    if options.size == Some(0) {
        return Err(Error::invalid("size", "expected at least 1 pixel, got 0"));
    }
    let shot = Shot { light_intensity: options.light_intensity.unwrap_or(shot.light_intensity), ..shot };
    let (stated, mut notes) = encoding.of_photo(pixels.samples);
    let (decoding, note) = Decoding::new(stated, colors, pixels.colors())
        .map_err(|got| Error::UnsupportedFormat { name: name.to_owned(), got })?;
    notes.extend(note);
    check_encoded(name, pixels, stated.transfer)?;
    let light_intensity = stated.color_space.unwrap_or_default().convert(ColorSpace::Rec709, shot.light_intensity);
    let shot = Shot { light_intensity, ..shot };
    shot.check(name)?;
    if pixels.has_alpha() {
        notes.push("alpha ignored".to_owned());
    }
    match pixels.samples {
        Samples::F32(values) => check_finite(name, values, pixels.width * pixels.channels)?,
        _ if white_level.is_some() => notes.push("white_level not used: the photo is not of floats".to_owned()),
        _ => {}
    }
    let colors = pixels.colors();
    let reader = RowReader::new(pixels, &decoding, white_level);
    let full_size = (pixels.width, pixels.height);
    let (width, height) = fit_size(pixels.width, pixels.height, options.size);
    let (mut values, mut saturated) = shrink(full_size, (width, height), colors, |y, row, saturated| {
        options.cancel.check()?;
        reader.read(y, row, Some(saturated));
        if let Some(mask) = mask {
            saturated.iter_mut().zip(&mask[y * full_size.0..]).for_each(|(bits, more)| *bits |= more);
        }
        Ok(())
    })?;
    if colors == 1 {
        values = memory::collected(3 * values.len(), values.iter().flat_map(|&grey| [grey; 3]))?;
        saturated.iter_mut().for_each(|bits| *bits = if *bits == 0 { 0 } else { 7 });
    }
    let mut image = Image::new(width, height, 3, values)?;
    if let Some(to_rec709) = &decoding.to_rec709 {
        apply_to_image(to_rec709, &mut image);
        check_finite(name, image.data(), 3 * width)?;
        for bits in &mut saturated {
            *bits = if *bits == 0 { 0 } else { 7 };
        }
    }
    let photo = Photo { name: name.to_owned(), shot, image, saturated };
    Ok(Loaded { photo, transfer: stated.transfer, full_size, assumed: None, notes })
}

/// Which channels of a photo are saturated, as the picture at `path` says: one byte a pixel.
///
/// # Errors
/// As [`read_stored`]; [`Error::ShapeMismatch`] for a picture of another size.
fn mask(path: &Path, photo: Pixels<'_>, cancel: &CancelToken) -> Result<Vec<u8>> {
    let stored = read_stored(path, cancel)?;
    let (width, height) = (photo.width, photo.height);
    if (stored.width, stored.height) != (width, height) {
        let (expected, got) = (format!("{width} x {height} pixels as its photo"), (stored.width, stored.height));
        return Err(Error::shape(path.display().to_string(), expected, format!("{} x {}", got.0, got.1)));
    }
    let (decoding, channels) = (Decoding::transfer(Transfer::Linear), stored.pixels().colors());
    let reader = RowReader::new(stored.pixels(), &decoding, None);
    let mut row = memory::filled(0.0f32, width * channels)?;
    let mut mask = memory::reserved(width * height)?;
    for y in 0..height {
        reader.read(y, &mut row, None);
        let bits = |pixel: &[f32]| (0..3).fold(0, |bits, c| bits | (u8::from(pixel[c % channels] >= 0.5) << c));
        mask.extend(row.chunks_exact(channels).map(bits));
    }
    Ok(mask)
}

/// The photos that a capture on disk names, none of which is opened.
///
/// # Errors
/// As [`Capture::open_with`].
#[cfg(feature = "cli")]
pub(crate) fn photo_files(path: &Path) -> Result<Vec<PathBuf>> {
    if is_image(path) {
        return Ok(vec![path.to_path_buf()]);
    }
    Ok(Layout::read(path)?.entries.into_iter().map(|entry| entry.path).collect())
}

fn check_patch_size(patch_size: f64) -> Result<()> {
    if patch_size.is_finite() && patch_size > 0.0 {
        return Ok(());
    }
    Err(Error::invalid("patch_size", format!("expected a finite number above 0, got {patch_size}")))
}

fn check_white_level(white_level: Option<f32>) -> Result<()> {
    match white_level {
        Some(level) if !(level.is_finite() && level > 0.0) => {
            Err(Error::invalid("white_level", format!("expected a finite number above 0, got {level}")))
        }
        _ => Ok(()),
    }
}

/// Floats up to here are believed to be encoded values of which 1 is white; what is above was never divided by its largest code.
const MAX_ENCODED: f32 = 8.0;

/// Fails for floats that stand for codes and not for encoded values. Linear floats have no upper end.
fn check_encoded(name: &str, pixels: Pixels<'_>, transfer: Transfer) -> Result<()> {
    let Samples::F32(values) = pixels.samples else { return Ok(()) };
    if transfer == Transfer::Linear {
        return Ok(());
    }
    let colors = values.chunks_exact(pixels.channels).flat_map(|pixel| &pixel[..pixels.colors()]);
    let largest = colors.copied().filter(|value| value.is_finite()).fold(0.0, f32::max);
    if largest <= MAX_ENCODED {
        return Ok(());
    }
    let (transfer, advice) =
        (transfer.name(), "divide by the largest code, 255 or 65535, or state that they are linear");
    Err(Error::invalid(
        name,
        format!(
            "expected floats of which 1 is white in {transfer}, at most {MAX_ENCODED}, got up to {largest}: {advice}"
        ),
    ))
}

/// `values` is checked for NaN and infinity; `row` is the length of a row in values.
fn check_finite(name: &str, values: &[f32], row: usize) -> Result<()> {
    match values.iter().position(|value| !value.is_finite()) {
        Some(at) => Err(Error::invalid(name, format!("pixel value {} in row {}", values[at], at / row.max(1)))),
        None => Ok(()),
    }
}

/// Loads photos on threads of our own, as many at a time as the budget of the run allows. Also the estimated bytes at the peak.
///
/// `demand` says what a photo takes, nothing for what is none; of several bad ones the first is reported, every time.
///
/// # Errors
/// [`Error::OutOfMemory`] before any is loaded, if there is not the memory for them one after the other; [`Error::Cancelled`]; what `load` returns.
fn read_all<T: Sync>(
    photos: &[T],
    demand: impl Fn(&T) -> Option<Demand> + Sync,
    load: impl Fn(&T) -> Result<Loaded> + Sync,
    options: &CaptureOptions,
) -> Result<(Vec<Loaded>, u64)> {
    check_count(photos.len())?;
    let cancel = &options.cancel;
    cancel.check()?;
    pool::inside(|| {
        let demands: Vec<Demand> =
            all(photos, photos.len(), |photo| Ok(demand(photo)))?.into_iter().flatten().collect();
        cancel.check()?;
        let (at_a_time, bytes) = plan(&demands, options)?;
        let loaded = all(photos, at_a_time, |photo| cancel.check().and_then(|()| load(photo)));
        cancel.check()?;
        Ok((loaded?, bytes))
    })
}

/// How many photos that make `demands` are read at a time within the budget, and the estimated bytes at the peak, those in use before included.
fn plan(demands: &[Demand], options: &CaptureOptions) -> Result<(usize, u64)> {
    let pixels = |&Demand { size: (width, height), .. }: &Demand| {
        let (width, height) = fit_size(width, height, options.size);
        (width as u64).saturating_mul(height as u64)
    };
    let kept = demands.iter().map(|demand| PIXEL_BYTES * pixels(demand)).sum::<u64>();
    let beside = |demand: &Demand| {
        // Grey becomes colour while the grey values are still there.
        let grey = if demand.colors == 1 { 4 * pixels(demand) } else { 0 };
        (demand.stored + grey).max(demand.decoding.saturating_sub(PIXEL_BYTES * pixels(demand)))
    };
    // A quarter of it for each photo: its tables and the decoder's.
    let beside = demands.iter().map(beside).max().unwrap_or(0) + memory::SMALL / 4;
    let bytes = |at_a_time: usize| options.in_use.saturating_add(kept).saturating_add(beside * at_a_time as u64);
    let allowed = memory::allowed(options.max_memory, options.in_use);
    let (width, height) = demands.first().map_or((0, 0), |demand| demand.size);
    memory::check(&format!("reading {} photos of {width} x {height} pixels", demands.len()), bytes(1), allowed)?;
    let at_most = rayon::current_num_threads().min(demands.len()).max(1);
    let at_a_time = (1..=at_most).rev().find(|&count| bytes(count) <= allowed).unwrap_or(1);
    Ok((at_a_time, bytes(at_a_time)))
}

/// What `work` makes of all photos, of `at_a_time` at a time, in their order; of its errors the first.
fn all<T: Sync, U: Send>(photos: &[T], at_a_time: usize, work: impl Fn(&T) -> Result<U> + Sync) -> Result<Vec<U>> {
    let (next, done) = (AtomicUsize::new(0), Mutex::new(Vec::with_capacity(photos.len())));
    let take_next = || {
        let index = next.fetch_add(1, Ordering::Relaxed);
        photos.get(index).map(|photo| (index, photo))
    };
    rayon::scope(|scope| {
        for _ in 0..at_a_time.min(photos.len()) {
            // Not a parallel iterator: whoever waits for the rows of one photo would begin with the next one.
            scope.spawn(|_| {
                while let Some((index, photo)) = take_next() {
                    let result = work(photo);
                    done.lock().unwrap_or_else(PoisonError::into_inner).push((index, result));
                }
            });
        }
    });
    let mut done = done.into_inner().unwrap_or_else(PoisonError::into_inner);
    done.sort_by_key(|(index, _)| *index);
    done.into_iter().map(|(_, result)| result).collect()
}

/// # Errors
/// [`Error::InvalidArgument`] for more photos than are taken.
fn check_count(count: usize) -> Result<()> {
    if count > MAX_PHOTOS {
        return Err(Error::invalid(
            "photos",
            format!("expected at most {MAX_PHOTOS}, got {count}: choose some with views"),
        ));
    }
    Ok(())
}

fn check_views(views: &[usize], photos: usize) -> Result<&[usize]> {
    if views.is_empty() {
        return Err(Error::invalid("views", "expected at least one photo, got none"));
    }
    for (i, &view) in views.iter().enumerate() {
        if view >= photos {
            return Err(Error::invalid(
                "views",
                format!("photo {view} of a capture of {photos} photos, counted from 0"),
            ));
        }
        if views[..i].contains(&view) {
            return Err(Error::invalid("views", format!("photo {view} is named twice")));
        }
    }
    Ok(views)
}
