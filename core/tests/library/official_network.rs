//! The network against outputs and gradients of the released architecture, computed in f64.

use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use crate::common::{Expected, fixture, relative_l2, shared};
use svbrdf_gcn::fit::paper::adapters::{Readout, fit_adapters};
use svbrdf_gcn::fit::paper::latent::fit_latent;
use svbrdf_gcn::nn::{AdapterParams, Adapters, Code, Decoding, Model, Network};
use svbrdf_gcn::progress::{CancelToken, Control, Progress};
use svbrdf_gcn::render::{Target, render_maps};
use svbrdf_gcn::{Lobe, Shot};

/// A Python with numpy: the one that `make setup` made, or one of the system's.
fn python() -> PathBuf {
    let local = Path::new(env!("CARGO_MANIFEST_DIR")).join("../.venv/bin/python");
    let candidates = [local, "python3".into(), "/usr/bin/python3".into()];
    let has_numpy = |python: &PathBuf| {
        let probe = Command::new(python).args(["-c", "import numpy"]).stderr(Stdio::null()).status();
        probe.is_ok_and(|status| status.success())
    };
    candidates.into_iter().find(has_numpy).expect("a Python with numpy; `make setup` installs one")
}

/// The fixture checkpoints as a weights file, through the script users have.
fn import(folder: &Path, gcn: &str, pairs: &[(&str, &str)]) -> Model {
    let out = tempfile::Builder::new().suffix(".safetensors").tempfile().unwrap();
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("../python/tools/import_checkpoint.py");
    let mut command = Command::new(python());
    command.arg(script).arg(out.path()).args(["--gcn", gcn, "--license", "random weights", "--roughness-floor", "-1"]);
    for (encoder, decoder) in pairs {
        command.arg("--pair").arg(folder.join(encoder)).arg(folder.join(decoder));
    }
    assert!(command.status().unwrap().success(), "{command:?}");
    let model = Model::load(out.path()).unwrap();
    assert_eq!(model.license(), "random weights");
    model
}

fn go_on(_: &Progress) -> ControlFlow<()> {
    ControlFlow::Continue(())
}

/// The raw maps of `code`, and everything on the way there.
fn raw_maps(network: &Network, code: &Code, control: &mut Control<'_>) -> Vec<f32> {
    let feature = network.decode(&code.latent, code, control).unwrap();
    let mut adapters = adapters(network, &feature, code);
    let mut raw = vec![0.0; adapters.raw_len()];
    adapters.forward(&params(network), &mut raw).unwrap();
    raw
}

fn adapters(network: &Network, feature: &[f32], code: &Code) -> Adapters {
    let outputs: Vec<usize> = network.adapters().iter().map(|adapter| adapter.outputs()).collect();
    Adapters::new(feature, network.config().feature_channels(), &outputs, code.width(), code.height()).unwrap()
}

fn params(network: &Network) -> Vec<f32> {
    network.adapters().iter().flat_map(|adapter| adapter.values.iter().copied()).collect()
}

#[test]
fn outputs_and_gradients_of_the_released_architecture() {
    let Some(folder) = shared("fixtures/official") else { return };
    let expected = Expected::open(&folder.join("expected.safetensors"));
    let mut callback = go_on;
    let mut control = Control::new(&mut callback, CancelToken::new());
    let images = expected.f32("images");
    let (height, width) = (32, 40);
    let photos: Vec<&[f32]> = images.chunks(3 * height * width).collect();
    let close = |got: &[f32], name: &str, tolerance: f64| {
        let error = relative_l2(got, &expected.f64(name));
        assert!(error < tolerance, "{name}: {error}");
    };

    // A fit of many photos takes the network for four, one of three the network for one.
    let model = import(&folder, "diagonal", &[("enc_4.ckpt", "dec.ckpt"), ("enc_1.ckpt", "dec.ckpt")]);
    let diagonal = model.network(9).unwrap();
    assert_eq!(diagonal.config().photos, 4);
    let code = diagonal.encode(&photos, height, width, &mut control).unwrap();
    close(&code.skip(0).unwrap(), "gcn_level0", 1e-5);
    close(&code.latent, "gcn_latent", 1e-5);
    let (feature, trace) = diagonal.decode_traced(&code.latent, &code, &mut control).unwrap();
    let mut adapters = adapters(diagonal, &feature, &code);
    let mut raw = vec![0.0; adapters.raw_len()];
    adapters.forward(&params(diagonal), &mut raw).unwrap();
    close(&raw, "gcn_maps", 1e-5);
    assert_eq!(raw, raw_maps(diagonal, &code, &mut control));

    // loss = mean(maps^2)
    let count = raw.len() as f64;
    let loss = raw.iter().map(|&value| f64::from(value).powi(2)).sum::<f64>() / count;
    close(&[loss as f32], "gcn_loss", 1e-5);
    let d_raw: Vec<f32> = raw.iter().map(|&value| (2.0 * f64::from(value) / count) as f32).collect();
    let mut d_params = vec![0.0; adapters.params_len()];
    let mut d_feature = vec![0.0; feature.len()];
    adapters.backward(&d_raw, Some(&mut d_params), Some(&mut d_feature)).unwrap();
    close(&trace.pull_back(&d_feature, &mut control).unwrap(), "grad_latent", 1e-4);
    let lengths: Vec<usize> = diagonal.adapters().iter().map(|adapter| adapter.values.len()).collect();
    let rough = lengths[0] + lengths[1];
    let place = diagonal.adapters()[2].range("conv1.weight").unwrap();
    close(&d_params[rough + place.start..rough + place.end], "grad_rough_conv1_weight", 1e-4);
    close(&d_params[diagonal.adapters()[0].range("end.bias").unwrap()], "grad_diff_end_bias", 1e-4);

    let single = model.network(3).unwrap();
    assert_eq!(single.config().photos, 1);
    let code = single.encode(&photos[..1], height, width, &mut control).unwrap();
    close(&code.latent, "single_latent", 1e-5);
    close(&raw_maps(single, &code, &mut control), "single_maps", 1e-5);
    assert!(single.encode(&photos, height, width, &mut control).is_err());

    let model = import(&folder, "full", &[("enc_4.ckpt", "dec.ckpt")]);
    let full = model.network(4).unwrap();
    let code = full.encode(&photos, height, width, &mut control).unwrap();
    close(&code.latent, "gcn_full_latent", 1e-5);
    close(&raw_maps(full, &code, &mut control), "gcn_full_maps", 1e-5);
    let message = model.network(3).unwrap_err().to_string();
    assert!(message.contains('4') && message.contains('3'), "{message}");

    let model = import(&folder, "diagonal", &[("enc_1.ckpt", "dec_aniso.ckpt")]);
    let anisotropic = model.network(1).unwrap();
    let code = anisotropic.encode(&photos[..1], height, width, &mut control).unwrap();
    close(&raw_maps(anisotropic, &code, &mut control), "aniso_maps", 1e-5);
}

#[test]
fn a_short_fit() {
    let Some(folder) = shared("fixtures/official") else { return };
    let expected = Expected::open(&fixture("official/fit.safetensors"));
    let model = import(&folder, "diagonal", &[("enc_4.ckpt", "dec.ckpt")]);
    let network = model.network(5).unwrap();
    // The loss before each step of either stage, as the caller hears of it: once a step and more often in between.
    let (mut losses, mut heard) = (Vec::new(), None);
    let mut callback = |progress: &Progress| {
        if let Some(loss) = progress.loss
            && heard.replace((progress.stage, progress.step)) != Some((progress.stage, progress.step))
        {
            losses.push(loss);
        }
        ControlFlow::Continue(())
    };
    let mut control = Control::new(&mut callback, CancelToken::new());
    let close = |got: &[f32], name: &str, tolerance: f64| {
        let error = relative_l2(got, &expected.f64(name));
        assert!(error < tolerance, "{name}: {error}");
    };
    let size = 32;
    let photos = expected.f32("photos");
    let photos: Vec<&[f32]> = photos.chunks(3 * size * size).collect();
    let position = |name: &str, photo: usize| -> [f64; 3] { expected.f64(name)[3 * photo..][..3].try_into().unwrap() };
    let target = |(photo, encoded): (usize, &&[f32])| {
        let light_intensity = position("light_intensity", 0);
        let shot = Shot { camera: position("camera", photo), light: position("light", photo), light_intensity };
        Target::new(size, size, shot, encoded, &vec![0; size * size]).unwrap()
    };
    let targets: Vec<Target> = photos.iter().enumerate().map(target).collect();

    let mut code = network.encode(&photos[..4], size, size, &mut control).unwrap();
    close(&code.latent, "z0", 1e-5);
    let mut params = network.adapters().to_vec();
    let (feature, trace) = network.decode_traced(&code.latent, &code, &mut control).unwrap();
    close(&raw_maps(network, &code, &mut control), "raw", 1e-5);
    let outputs: Vec<usize> = params.iter().map(AdapterParams::outputs).collect();
    let mut readout = Readout::new(&feature, 9, &outputs, Decoding::new(Lobe::Isotropic), 10.0, &targets).unwrap();
    let flat: Vec<f32> = params.iter().flat_map(|adapter| adapter.values.clone()).collect();
    let mut d_feature = vec![0.0; feature.len()];
    readout.loss(&flat, None, Some(&mut d_feature), &mut control).unwrap();
    let maps = |readout: &Readout<'_>, prefix: &str| {
        let planes =
            |first: usize, count: usize| readout.maps().data()[first * size * size..][..count * size * size].to_vec();
        close(&planes(0, 3), &format!("{prefix}_diffuse"), 1e-4);
        close(&planes(3, 3), &format!("{prefix}_normal"), 1e-4);
        close(&planes(6, 1), &format!("{prefix}_roughness"), 1e-4);
        close(&planes(7, 3), &format!("{prefix}_specular"), 1e-4);
    };
    maps(&readout, "map");
    let rendered: Vec<f32> =
        targets.iter().flat_map(|target| render_maps(readout.maps(), 10.0, target.shot()).unwrap()).collect();
    close(&rendered, "radiance", 1e-4);
    close(&trace.pull_back(&d_feature, &mut control).unwrap(), "grad_z0", 1e-4);

    let latent = fit_latent(network, &mut code, &params, &mut readout, 3, None, &mut control).unwrap();
    close(&code.latent, "z3", 1e-4);
    let rest = fit_adapters(&mut readout, &mut params, 5, None, &mut control).unwrap();
    losses.push(rest.last_loss);
    for (step, (got, expected)) in losses.iter().zip(expected.f64("losses")).enumerate() {
        assert!((got / expected - 1.0).abs() < 1e-5, "loss {step}: {got} {expected}");
    }
    assert_eq!(losses.len(), 9);
    assert_eq!(latent.last_loss, rest.first_loss, "the second stage starts where the first ended");
    maps(&readout, "final");
    for (adapter, (name, _)) in params.iter().zip(network.config().adapters()) {
        for (tensor, _, range) in AdapterParams::tensors(9, adapter.outputs()) {
            let part = if tensor.starts_with("end.") { "" } else { "conv." };
            close(&adapter.values[range], &format!("adapter5.{name}.{part}{tensor}"), 1e-4);
        }
    }
}
