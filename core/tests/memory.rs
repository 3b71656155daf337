//! Estimates of memory against what is taken from the allocator.

#![allow(clippy::unwrap_used, reason = "a test may panic")]
#![allow(unsafe_code, reason = "an allocator that counts")]

#[path = "library/common/material.rs"]
mod material;

use std::alloc::{GlobalAlloc, Layout, System};
use std::ops::ControlFlow;
use std::path::Path;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, PoisonError};

use svbrdf_gcn::io::material::SaveOptions;
use svbrdf_gcn::nn::Model;
use svbrdf_gcn::{Capture, CaptureOptions, Error, FitOptions, Image, Method, Progress, Shot, Transfer, fit_material};

/// Counts the bytes that live, and their largest number.
struct Counting;

static LIVING: AtomicUsize = AtomicUsize::new(0);
static PEAK: AtomicUsize = AtomicUsize::new(0);

impl Counting {
    fn grow(bytes: usize) {
        let living = LIVING.fetch_add(bytes, Ordering::Relaxed) + bytes;
        PEAK.fetch_max(living, Ordering::Relaxed);
    }

    fn shrink(bytes: usize) {
        LIVING.fetch_sub(bytes, Ordering::Relaxed);
    }
}

// SAFETY: the system's allocator does all the work.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        Self::grow(layout.size());
        // SAFETY: the caller's word.
        unsafe { System.alloc(layout) }
    }

    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        Self::grow(layout.size());
        // SAFETY: the caller's word.
        unsafe { System.alloc_zeroed(layout) }
    }

    unsafe fn dealloc(&self, place: *mut u8, layout: Layout) {
        Self::shrink(layout.size());
        // SAFETY: the caller's word.
        unsafe { System.dealloc(place, layout) }
    }

    unsafe fn realloc(&self, place: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        // Where it moves, both are there for a moment.
        Self::grow(size);
        // SAFETY: the caller's word.
        let moved = unsafe { System.realloc(place, layout, size) };
        Self::shrink(layout.size());
        moved
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// One test at a time.
static ALONE: Mutex<()> = Mutex::new(());

/// What `work` gives, and how many bytes more than before lived at its peak.
fn peak<T>(work: impl FnOnce() -> T) -> (T, usize) {
    let before = LIVING.load(Ordering::Relaxed);
    PEAK.store(before, Ordering::Relaxed);
    let result = work();
    (result, PEAK.load(Ordering::Relaxed) - before)
}

/// A capture on disk.
fn write_capture(folder: &Path, side: usize, count: usize) {
    let mut photos = Vec::new();
    for index in 0..count {
        let value = |i: usize| {
            let (x, y) = (i / 3 % side, i / 3 / side);
            0.1 + 0.4 * ((x / 8 * 7 + y / 8 * 13 + i % 3 * 5 + index) % 17) as f32 / 17.0
        };
        let image = Image::new(side, side, 3, (0..3 * side * side).map(value).collect()).unwrap();
        let name = format!("{index}.png");
        svbrdf_gcn::io::write_image(folder.join(&name), &image, Transfer::Srgb).unwrap();
        let angle = index as f64;
        photos.push(format!(r#"{{"file": "{name}", "camera": [{}, {}, 2.2]}}"#, 0.5 * angle.cos(), 0.5 * angle.sin()));
    }
    let text = format!(
        r#"{{"format": "svbrdf-gcn capture", "version": 1, "patch_size": 2, "transfer": "srgb", "light_intensity": 12, "photos": [{}]}}"#,
        photos.join(", ")
    );
    std::fs::write(folder.join("capture.json"), text).unwrap();
}

fn within(estimate: u64, peak: usize) -> bool {
    (1.0..=1.3).contains(&(estimate as f64 / peak as f64))
}

/// The estimate in the report is 1.0 to 1.3 times what lives at the peak of reading and fit together.
#[test]
fn estimates_of_fits() {
    let _alone = ALONE.lock().unwrap_or_else(PoisonError::into_inner);
    // Loaded once for all fits.
    let weights = Model::embedded().unwrap();
    let mut wrong = Vec::new();
    for (side, count, method) in [
        (128, 4, Method::Network),
        (128, 32, Method::Network),
        (512, 4, Method::Network),
        (512, 32, Method::Network),
        (128, 32, Method::Direct),
        (512, 4, Method::Direct),
    ] {
        let folder = tempfile::tempdir().unwrap();
        write_capture(folder.path(), side, count);
        // Rounds of the direct stage begin at 50 steps each. With many photos that would take long, and so would the finish, which never takes the most.
        let (steps, finish) = if count < 32 { (100, 1) } else { (2, 0) };
        let options = FitOptions::default().method(method).direct_steps(steps).finish_steps(finish).threads(2);
        let (fit, taken) = peak(|| {
            let capture = Capture::open(folder.path()).unwrap();
            fit_material(&capture, None, &options, &mut |_: &Progress| ControlFlow::Continue(())).unwrap()
        });
        let taken = taken + if method == Method::Network { weights.memory() as usize } else { 0 };
        let estimate = fit.report.memory_estimate;
        let line = format!("{method:?} {side} {count}: {estimate} {taken} {:.3}", estimate as f64 / taken as f64);
        eprintln!("{line}");
        if !within(estimate, taken) {
            wrong.push(line);
        }
    }
    assert!(wrong.is_empty(), "{wrong:#?}");
}

/// What a refusal says is needed.
fn needed(result: svbrdf_gcn::Result<Capture>) -> u64 {
    match result.unwrap_err() {
        Error::OutOfMemory { needed, allowed: Some(_), .. } => needed,
        other => panic!("{other}"),
    }
}

/// What reading takes is known before anything is decoded, for every kind of file.
#[test]
fn budgets_of_reading() {
    let _alone = ALONE.lock().unwrap_or_else(PoisonError::into_inner);
    let side = 600;
    let noise = |i: usize| 0.1 + 0.3 * (i * 7919 % 1009) as f32 / 1009.0;
    for (name, channels) in
        [("a.png", 1), ("b.png", 3), ("c.jpg", 3), ("d.jpg", 1), ("e.tif", 3), ("f.exr", 3), ("g.exr", 1)]
    {
        let folder = tempfile::tempdir().unwrap();
        let image = Image::new(side, side, channels, (0..channels * side * side).map(noise).collect()).unwrap();
        let path = folder.path().join(name);
        svbrdf_gcn::io::write_image(&path, &image, Transfer::Srgb).unwrap();
        drop(image);
        let transfer = if name < "e" { Transfer::Srgb } else { Transfer::Linear };
        let shot = Shot { camera: [0.0, 0.0, 2.2], light: [0.0, 0.0, 2.2], light_intensity: [12.0; 3] };
        let files: Vec<_> = (0..6).map(|_| (path.clone(), shot)).collect();
        for (count, size) in [(1, side), (6, 100)] {
            let open = |budget: u64| {
                let options = CaptureOptions::new().size(size).max_memory(budget);
                Capture::from_files(&files[..count], 2.0, transfer, None, &options)
            };
            let (refused, little) = peak(|| open(0));
            let least = needed(refused);
            // The header of a TIFF may be anywhere in it.
            let file = if name.ends_with("tif") { std::fs::metadata(&path).unwrap().len() as usize } else { 0 };
            let threads = std::thread::available_parallelism().unwrap().get();
            assert!(little < threads * file + (1 << 20), "{name}: {little} bytes to refuse");
            assert_eq!(needed(open(least - 1)), least);
            let (capture, taken) = peak(|| open(least));
            assert!(within(least, taken), "{name} {count}: {least} {taken}");
            for budget in [2 * least, 100 * least] {
                let (other, taken) = peak(|| open(budget));
                assert_eq!(other.unwrap(), *capture.as_ref().unwrap());
                assert!(taken as u64 <= budget, "{name}: {taken} of {budget}");
            }
        }
    }
}

/// Commands that need no photos are refused a budget below their peak, and take one of 1.3 times it.
#[test]
fn budgets_of_commands() {
    let _alone = ALONE.lock().unwrap_or_else(PoisonError::into_inner);
    let folder = tempfile::tempdir().unwrap();
    let side = 256;
    let material = material::noise(side);
    let maps = folder.path().join("maps");
    material.save(&maps, &SaveOptions::default()).unwrap();
    drop(material);
    let (maps, out) = (maps.to_str().unwrap(), folder.path().join("out"));
    let mut wrong = Vec::new();
    for (command, file) in [
        (vec!["render", maps, "--camera", "0,0,2", "--light", "0,0,2"], "a.png"),
        (vec!["render", maps, "--camera", "0,0,2", "--light", "0,0,2"], "b.exr"),
        (vec!["export", maps, "--to", "gltf"], "gltf"),
        (vec!["export", maps, "--to", "materialx"], "materialx"),
        (vec!["export", maps, "--to", "principled"], "principled"),
        (vec!["export", maps, "--to", "unreal"], "unreal"),
    ] {
        let file = out.join(file);
        std::fs::create_dir_all(&out).unwrap();
        let run = |budget: Option<u64>| {
            let budget = budget.map(|budget| format!("--max-memory={budget}"));
            let own = ["svbrdf-gcn"].into_iter().chain(command.iter().copied()).chain(["-o", file.to_str().unwrap()]);
            let arguments: Vec<&str> = own.chain(budget.as_deref()).collect();
            peak(|| svbrdf_gcn::cli::main(&arguments))
        };
        let (code, taken) = run(None);
        assert_eq!(code, 0, "{command:?}");
        let (below, above) = (taken as u64 - 1, (1.3 * taken as f64) as u64);
        let codes = (run(Some(below)).0, run(Some(above)).0);
        eprintln!("{command:?}: {:.1} bytes a pixel, {codes:?}", taken as f64 / (side * side) as f64);
        if codes != (6, 0) {
            wrong.push((command, taken, codes));
        }
    }
    assert!(wrong.is_empty(), "{wrong:?}");
}
