//! A photo graph as data.

use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};

use crate::error::Result;
use crate::nn::config::{ISOTROPIC_ADAPTERS, TensorSpec, check_roughness_floor, within};
use crate::nn::kernels::NORM_EPSILON;
use crate::nn::params::block_tensors;
use crate::nn::weights::broken;

/// Planes that the network sees of every photo.
pub(crate) const INPUTS: usize = 13;
/// Largest encoded ratio to a white diffuse surface that the network is shown.
pub(crate) const RATIO_MAX: f64 = 4.0;
/// Added to the variance over photos before its root.
pub(crate) const SPREAD_EPSILON: f64 = 1e-4;
/// Planes of what the photos tell without learning.
pub(crate) const HINTS: usize = 10;
/// Ridge of the regression in them, in squared units of the half vectors.
pub(crate) const HINT_RIDGE: f64 = 1e-2;
/// Bounds of the logarithm of the standard deviation.
pub(crate) const LOG_SIGMA: [f64; 2] = [-7.0, 1.0];
/// Raw planes of all adapters.
pub(crate) const RAW_PLANES: usize = 9;

/// What a weights file calls this architecture.
const KIND: &str = "photo graph";
/// What a weights file says of the planes of a photo.
const INPUT_PLANES: &str =
    "photo gamma2.2 3, ratio to white diffuse gamma2.2 3, saturated 1, light direction 3, half vector 3";
/// What a weights file says of the hints.
const HINT_PLANES: &str =
    "slope of ratio in half vector xy 2, highlight in half vector xy 2, least ratio 3, mean ratio 3";

/// Sizes and form of a photo graph (`python/svbrdf_gcn/training/model.py` states the network in full).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PhotoGraphConfig {
    /// Channels per photo at full resolution.
    pub stem: usize,
    /// NAFNet blocks per photo at full resolution.
    pub stem_blocks: usize,
    /// Channels per photo at half resolution.
    pub node: usize,
    /// Heads of the attention between photos; a divisor of `node`.
    pub heads: usize,
    /// Channels of a query or key of one head.
    pub dim: usize,
    /// Rounds of messages between photos.
    pub rounds: usize,
    /// Channels of the trunk at half resolution; twice as many at each coarser level.
    pub width: usize,
    /// NAFNet blocks of the trunk's encoder, and of its decoder, at each level, half resolution first.
    pub blocks: Vec<usize>,
    /// NAFNet blocks at the trunk's coarsest resolution.
    pub middle: usize,
    /// Channels at full resolution after the trunk.
    pub tail: usize,
    /// NAFNet blocks at full resolution after the trunk.
    pub tail_blocks: usize,
    /// Channels of the material feature that the adapters read.
    pub feature: usize,
    /// Side in pixels of full resolution of the windows that channel attention averages over; none: the whole picture.
    pub window: Option<usize>,
    /// Raw roughness below this decodes as this.
    pub roughness_floor: f32,
}

/// What a weights file states of the architecture beside the sizes.
#[derive(Debug, PartialEq, Serialize, Deserialize)]
struct Form {
    kind: String,
    inputs: String,
    hints: String,
    hint_ridge: f64,
    ratio_max: f64,
    norm_eps: f64,
    spread_eps: f64,
    log_sigma: [f64; 2],
    adapters: Vec<(String, usize)>,
}

impl Form {
    const FIELDS: [&str; 9] =
        ["kind", "inputs", "hints", "hint_ridge", "ratio_max", "norm_eps", "spread_eps", "log_sigma", "adapters"];

    /// The one form that this crate computes.
    fn known() -> Self {
        Self {
            kind: KIND.into(),
            inputs: INPUT_PLANES.into(),
            hints: HINT_PLANES.into(),
            hint_ridge: HINT_RIDGE,
            ratio_max: RATIO_MAX,
            norm_eps: NORM_EPSILON,
            spread_eps: SPREAD_EPSILON,
            log_sigma: LOG_SIGMA,
            adapters: ISOTROPIC_ADAPTERS.map(|(name, planes)| (name.into(), planes)).into(),
        }
    }
}

impl Default for PhotoGraphConfig {
    /// The sizes of the `default` network.
    fn default() -> Self {
        Self {
            stem: 16,
            stem_blocks: 0,
            node: 32,
            heads: 2,
            dim: 8,
            rounds: 1,
            width: 64,
            blocks: vec![2, 3],
            middle: 3,
            tail: 16,
            tail_blocks: 1,
            feature: 9,
            window: Some(96),
            roughness_floor: -0.5,
        }
    }
}

impl PhotoGraphConfig {
    /// The configuration in a weights file's entry `architecture`, validated.
    pub(crate) fn parse(text: &str) -> Result<Self> {
        let unreadable = |error: serde_json::Error| broken(format!("metadata entry \"architecture\": {error}"));
        let mut sizes: Map<String, Value> = serde_json::from_str(text).map_err(unreadable)?;
        let mut form = Map::new();
        for field in Form::FIELDS {
            let value = sizes.remove(field);
            let value = value.ok_or_else(|| broken(format!("metadata entry \"architecture\": {field} is missing")))?;
            // The kind first: of another kind nothing else can be expected to fit.
            if field == "kind" && value != KIND {
                return Err(broken(format!("architecture: expected kind \"{KIND}\", got {value}")));
            }
            form.insert(field.into(), value);
        }
        let form: Form = serde_json::from_value(form.into()).map_err(unreadable)?;
        let known = Form::known();
        if form != known {
            return Err(broken(format!("architecture: expected {known:?}, got {form:?}")));
        }
        let config: Self = serde_json::from_value(sizes.into()).map_err(unreadable)?;
        config.validate()?;
        Ok(config)
    }

    /// The inverse of [`PhotoGraphConfig::parse`], not yet text.
    pub(crate) fn architecture(&self) -> serde_json::Result<Value> {
        let mut all = serde_json::to_value(Form::known())?;
        if let (Value::Object(all), Value::Object(sizes)) = (&mut all, serde_json::to_value(self)?) {
            all.extend(sizes);
        }
        Ok(all)
    }

    /// Fails unless the sizes make a network of sane size.
    pub(crate) fn validate(&self) -> Result<()> {
        within("stem", self.stem, 1, 512)?;
        within("node", self.node, 1, 1024)?;
        within("heads", self.heads, 1, 64)?;
        within("dim", self.dim, 1, 256)?;
        within("width", self.width, 1, 1024)?;
        within("tail", self.tail, 1, 512)?;
        within("feature", self.feature, 1, 512)?;
        within("levels", self.levels(), 1, 6)?;
        within("rounds", self.rounds, 0, 16)?;
        for (name, count) in
            [("stem_blocks", self.stem_blocks), ("middle", self.middle), ("tail_blocks", self.tail_blocks)]
        {
            within(name, count, 0, 64)?;
        }
        for &count in &self.blocks {
            within("blocks of a level", count, 0, 64)?;
        }
        within("window", self.window.unwrap_or(1), 1, 1 << 20)?;
        if !self.node.is_multiple_of(self.heads) {
            return Err(broken(format!("node: expected a multiple of {} heads, got {}", self.heads, self.node)));
        }
        check_roughness_floor(self.roughness_floor)
    }

    /// Levels of the trunk below its first, each of half the resolution of the one before.
    pub fn levels(&self) -> usize {
        self.blocks.len()
    }

    /// Sides of pictures are continued with zeros to multiples of this many pixels.
    pub fn grain(&self) -> usize {
        2 << self.levels()
    }

    /// Side of the windows in pixels of `level`, 0 the full resolution.
    pub(crate) fn window_at(&self, level: usize) -> Option<usize> {
        self.window.map(|window| (window >> level).max(1))
    }

    /// Channels of the trunk at its level `level`, 0 half the resolution.
    pub(crate) fn channels(&self, level: usize) -> usize {
        self.width << level
    }

    /// All tensors, as named in a weights file, and their shapes.
    pub(crate) fn tensors(&self) -> Vec<TensorSpec> {
        let mut list: Vec<TensorSpec> = Vec::new();
        let layer = |list: &mut Vec<TensorSpec>, name: &str, shape: [usize; 4]| {
            list.push((format!("{name}.weight"), shape.to_vec()));
            list.push((format!("{name}.bias"), vec![shape[0]]));
        };
        let block = |list: &mut Vec<TensorSpec>, name: &str, channels: usize| {
            // Only kernels have four dimensions, as in the training code's files.
            let own = |tensor: &str, shape: [usize; 4]| match tensor.split_once('.') {
                Some((layer, "weight" | "1.weight")) if !layer.starts_with("norm") => shape.to_vec(),
                _ => shape[..1].to_vec(),
            };
            list.extend(
                block_tensors(channels).map(|(tensor, shape)| (format!("{name}.{tensor}"), own(tensor, shape))),
            );
        };
        let blocks = |list: &mut Vec<TensorSpec>, name: &str, count: usize, channels: usize| {
            (0..count).for_each(|index| block(list, &format!("{name}.{index}"), channels));
        };
        let Self { stem, node, width, tail, feature, .. } = *self;
        layer(&mut list, "intro", [stem, INPUTS, 3, 3]);
        blocks(&mut list, "stem", self.stem_blocks, stem);
        layer(&mut list, "fold", [node, stem, 2, 2]);
        blocks(&mut list, "node", 1, node);
        for round in (0..self.rounds).map(|round| format!("rounds.{round}")) {
            list.extend(["weight", "bias"].map(|name| (format!("{round}.norm.{name}"), vec![node])));
            for (name, outputs) in
                [("query", self.heads * self.dim), ("key", self.heads * self.dim), ("value", node), ("out", node)]
            {
                layer(&mut list, &format!("{round}.{name}"), [outputs, node, 1, 1]);
            }
            list.push((format!("{round}.pair"), vec![self.heads, 2]));
            list.push((format!("{round}.loop"), vec![self.heads]));
            list.push((format!("{round}.gain"), vec![node]));
            block(&mut list, &format!("{round}.block"), node);
        }
        layer(&mut list, "entry", [width, 3 * node + HINTS + 1, 1, 1]);
        for (level, &count) in self.blocks.iter().enumerate() {
            blocks(&mut list, &format!("encoders.{level}"), count, self.channels(level));
            layer(&mut list, &format!("downs.{level}"), [self.channels(level + 1), self.channels(level), 2, 2]);
        }
        blocks(&mut list, "middle_blks", self.middle, self.channels(self.levels()));
        for (step, level) in (0..self.levels()).rev().enumerate() {
            list.push((format!("ups.{step}.0.weight"), vec![4 * self.channels(level), self.channels(level + 1), 1, 1]));
            blocks(&mut list, &format!("decoders.{step}"), self.blocks[level], self.channels(level));
        }
        list.push(("unfold.weight".into(), vec![4 * tail, width, 1, 1]));
        layer(&mut list, "skip", [tail, 3 * stem + HINTS + 1, 1, 1]);
        blocks(&mut list, "tail", self.tail_blocks, tail);
        layer(&mut list, "ending", [feature, tail, 3, 3]);
        for (name, outputs) in ISOTROPIC_ADAPTERS {
            block(&mut list, &format!("{name}.conv"), feature);
            layer(&mut list, &format!("{name}.end"), [outputs, feature, 3, 3]);
        }
        block(&mut list, "certainty.conv", tail);
        layer(&mut list, "certainty.end", [RAW_PLANES, tail, 3, 3]);
        list
    }
}

#[cfg(test)]
mod tests {
    use super::PhotoGraphConfig;

    #[test]
    fn architectures_there_and_back() {
        for config in [
            PhotoGraphConfig::default(),
            PhotoGraphConfig { window: None, roughness_floor: -1.0, ..PhotoGraphConfig::default() },
        ] {
            let text = config.architecture().unwrap().to_string();
            assert_eq!(PhotoGraphConfig::parse(&text).unwrap(), config);
        }
    }

    #[test]
    fn other_architectures_are_refused() {
        let good = PhotoGraphConfig::default().architecture().unwrap();
        let huge = u64::MAX;
        for (field, value) in [
            ("kind", serde_json::json!("gcn")),
            ("kind", serde_json::json!(null)),
            ("inputs", serde_json::json!("photo 3")),
            ("hints", serde_json::json!("none")),
            ("hint_ridge", serde_json::json!(1e-3)),
            ("ratio_max", serde_json::json!(3.0)),
            ("norm_eps", serde_json::json!(1e-5)),
            ("spread_eps", serde_json::json!("none")),
            ("log_sigma", serde_json::json!([-7.0, 2.0])),
            ("adapters", serde_json::json!([["diff_conv", 3]])),
            ("stem", serde_json::json!(0)),
            ("stem", serde_json::json!(-1)),
            ("node", serde_json::json!(33)),
            ("heads", serde_json::json!(0)),
            ("dim", serde_json::json!(huge)),
            ("rounds", serde_json::json!(huge)),
            ("width", serde_json::json!(1u64 << 40)),
            ("blocks", serde_json::json!([])),
            ("blocks", serde_json::json!([1, 1, 1, 1, 1, 1, 1])),
            ("blocks", serde_json::json!([huge])),
            ("middle", serde_json::json!(huge)),
            ("tail", serde_json::json!(huge)),
            ("feature", serde_json::json!(0)),
            ("window", serde_json::json!(0)),
            ("roughness_floor", serde_json::json!(1.0)),
            ("surplus", serde_json::json!(1)),
        ] {
            let mut broken = good.clone();
            broken[field] = value;
            let message = PhotoGraphConfig::parse(&broken.to_string()).unwrap_err().to_string();
            assert!(
                message.contains("architecture") || message.contains(field) || message.contains("levels"),
                "{message}"
            );
        }
        for field in good.as_object().unwrap().keys().filter(|field| *field != "window") {
            let mut without = good.clone();
            without.as_object_mut().unwrap().remove(field);
            assert!(PhotoGraphConfig::parse(&without.to_string()).is_err(), "{field}");
        }
        for text in ["", "[]", "{", "null", "1e999"] {
            assert!(PhotoGraphConfig::parse(text).is_err(), "{text}");
        }
    }
}
