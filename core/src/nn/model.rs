//! Weights files and the networks they hold.

use std::collections::{BTreeMap, HashMap};
use std::fs::File;
use std::io::{BufReader, BufWriter, Cursor, Read, Seek};
use std::path::Path;
use std::sync::{Arc, OnceLock};

use super::config::NetworkConfig;
use super::layout::Layout;
use super::network::{Decoder, Encoded, Encoder, Trace};
use super::params::AdapterParams;
use super::photo_graph::{PhotoGraph, PhotoGraphConfig};
use super::tape::{Image, Loss, Param, Planes, Pool, Recording, unpacked};
use super::weights::{self, CHECKSUMS, Reader, broken};
use crate::error::{Error, Result};
use crate::io::file;
use crate::io::save::Temporary;
use crate::maps::Lobe;
use crate::progress::Control;

/// The default network's weights file.
const EMBEDDED: &[u8] = include_bytes!("../../weights/default.safetensors");

/// The version of files with checksums. A version of its own, so that no single flipped bit makes of a file with them one without.
const VERSION: &str = "2";
/// The version of files without checksums, which are read and not written.
const VERSION_UNCHECKED: &str = "1";

/// What a weights file must say about itself beside its version: key, value.
const CONVENTIONS: [(&str, &str); 4] = [
    ("format", "svbrdf-gcn weights"),
    ("brdf", "paper"),
    ("roughness", "perceptual"),
    ("color_space", "photos gamma2.2, albedos gamma2.2 of [-1, 1]"),
];

/// Sets of feature planes that a decoder block keeps for the way back.
const STORED_PER_BLOCK: u64 = 5;
/// Sets of feature planes at the finest level that are alive besides: a block at work, the gradient.
const WORKING_PLANES: u64 = 10;

/// The order of the adapters' outputs, as a weights file states it.
fn channel_order(lobe: Lobe) -> &'static str {
    match lobe {
        Lobe::Isotropic => "diffuse 3, normal 2, roughness 1, specular 3",
        Lobe::Anisotropic => "diffuse 3, normal 3, roughness 2, specular 3, tangent 3",
    }
}

/// What a weights file holds: the paper's networks, one for each number of photos they were trained for, or a [`PhotoGraph`].
///
/// Immutable, `Send` and `Sync`: load it once and share it by [`Arc`].
#[derive(Debug)]
pub struct Model {
    content: Content,
    license: String,
    /// What else the file says of itself, such as `data` and `training`.
    facts: BTreeMap<String, String>,
    has_checksums: bool,
}

#[derive(Debug)]
enum Content {
    /// That for the fewest photos first; at least one.
    Networks(Vec<Network>),
    PhotoGraph(Box<PhotoGraph>),
}

/// The entries of the metadata that [`Model`] itself reads and writes, beside [`CONVENTIONS`].
const OWN_METADATA: [&str; 6] = ["version", "channels", "license", "networks", "architecture", CHECKSUMS];

impl Model {
    /// Loads a weights file, all networks in it.
    ///
    /// # Errors
    /// [`Error::Io`] if the file cannot be opened; [`Error::Weights`] if it is not a weights file of this version, is damaged, states
    /// other conventions, or holds tensors that are missing, unknown, of another shape or not finite.
    pub fn load(path: impl AsRef<Path>) -> Result<Self> {
        Self::read(Self::open(path.as_ref())?, None)
    }

    /// Loads only the network that a fit with `photos` photos takes: the one for the most photos that are there, or the photo graph.
    ///
    /// # Errors
    /// As [`Model::load`] and [`Model::network`].
    pub fn load_for(path: impl AsRef<Path>, photos: usize) -> Result<Self> {
        Self::read(Self::open(path.as_ref())?, Some(photos))
    }

    /// The default network, which is part of the library: a photo graph for any number of photos, see `docs/model-card.md`.
    ///
    /// # Errors
    /// As [`Model::load`], if the library's build was damaged.
    pub fn embedded() -> Result<Arc<Self>> {
        static MODEL: OnceLock<Result<Arc<Model>>> = OnceLock::new();
        let loaded = MODEL.get_or_init(|| Self::from_bytes(EMBEDDED).map(Arc::new));
        loaded.as_ref().map(Arc::clone).map_err(|error| broken(error.to_string()))
    }

    /// As [`Model::load`], from a file's content.
    ///
    /// # Errors
    /// As [`Model::load`].
    pub fn from_bytes(bytes: &[u8]) -> Result<Self> {
        Self::read(Cursor::new(bytes), None)
    }

    /// Networks of these sizes with random weights, the same for the same `seed`: for benchmarks and tests.
    ///
    /// # Errors
    /// [`Error::Weights`] if a size is out of range, or two networks are for the same number of photos.
    pub fn random(configs: &[NetworkConfig], seed: u64) -> Result<Self> {
        check_together(configs)?;
        let mut state = seed;
        let networks = configs
            .iter()
            .map(|config| Network::new(config.clone(), |name, shape| Ok(random_tensor(name, shape, &mut state))));
        let networks = networks.collect::<Result<_>>()?;
        Ok(Self::from_networks(networks, "random weights, no licence needed".into(), BTreeMap::new()))
    }

    /// A model of this photo graph.
    pub fn from_photo_graph(graph: PhotoGraph, license: impl Into<String>) -> Self {
        Self {
            content: Content::PhotoGraph(Box::new(graph)),
            license: license.into(),
            facts: BTreeMap::new(),
            has_checksums: false,
        }
    }

    /// Writes all networks, as `f32`, with checksums.
    ///
    /// # Errors
    /// [`Error::Io`] if the file cannot be written.
    pub fn save(&self, path: impl AsRef<Path>) -> Result<()> {
        let path = path.as_ref();
        let mut tensors = Vec::new();
        match &self.content {
            Content::Networks(networks) => networks.iter().for_each(|network| {
                let prefix = prefix(&network.config);
                network.for_each_tensor(|name, shape, values| tensors.push((format!("{prefix}{name}"), shape, values)));
            }),
            Content::PhotoGraph(graph) => {
                graph.for_each_tensor(|name, shape, values| tensors.push((name.to_owned(), shape, values)));
            }
        }
        let metadata = self.metadata().map_err(|error| Error::io(path, error))?;
        let mut out = BufWriter::new(Temporary::beside(path)?);
        weights::write(&mut out, metadata, &tensors).map_err(|error| Error::io(path, error))?;
        out.into_inner().map_err(|error| Error::io(path, error.into_error()))?.persist(path)
    }

    /// The network for the most photos that `photos` photos suffice for.
    ///
    /// # Errors
    /// [`Error::Weights`] naming both numbers if even the network for the fewest photos needs more, or if the model is a photo graph.
    pub fn network(&self, photos: usize) -> Result<&Network> {
        let Content::Networks(networks) = &self.content else {
            return Err(broken("expected the paper's networks, got a photo graph"));
        };
        networks
            .iter()
            .rev()
            .find(|network| network.config.photos <= photos)
            .ok_or_else(|| too_few(networks.first().map_or(0, |network| network.config.photos), photos))
    }

    /// All networks of the paper's form, that for the fewest photos first; none if the model is a photo graph.
    pub fn networks(&self) -> &[Network] {
        match &self.content {
            Content::Networks(networks) => networks,
            Content::PhotoGraph(_) => &[],
        }
    }

    /// The photo graph, if the model is one.
    pub fn photo_graph(&self) -> Option<&PhotoGraph> {
        match &self.content {
            Content::Networks(_) => None,
            Content::PhotoGraph(graph) => Some(graph),
        }
    }

    /// What else the file says of itself: `data` on what the weights were trained and `training` how, where it says so. Not checked.
    pub fn facts(&self) -> &BTreeMap<String, String> {
        &self.facts
    }

    /// Whether the file that the model was read from has checksums, which have then been verified. Files of version 1 have none: damage to
    /// their values may go unnoticed.
    pub fn has_checksums(&self) -> bool {
        self.has_checksums
    }

    /// Bytes of its weights in memory.
    pub fn memory(&self) -> u64 {
        let parameters = match &self.content {
            Content::Networks(networks) => networks.iter().map(Network::parameters).sum(),
            Content::PhotoGraph(graph) => graph.parameters(),
        };
        (parameters * size_of::<f32>()) as u64
    }

    /// The licence the weights come under, as their file states it.
    pub fn license(&self) -> &str {
        &self.license
    }

    fn open(path: &Path) -> Result<BufReader<File>> {
        Ok(BufReader::new(file::open(path)?.0))
    }

    fn from_networks(mut networks: Vec<Network>, license: String, facts: BTreeMap<String, String>) -> Self {
        networks.sort_by_key(|network| network.config.photos);
        Self { content: Content::Networks(networks), license, facts, has_checksums: false }
    }

    fn read(source: impl Read + Seek, photos: Option<usize>) -> Result<Self> {
        let mut reader = Reader::open(source)?;
        let has_checksums = reader.has_checksums();
        for (key, expected) in CONVENTIONS {
            let got = reader.metadata(key)?;
            if got != expected {
                return Err(broken(format!("metadata entry \"{key}\": expected \"{expected}\", got \"{got}\"")));
            }
        }
        match reader.metadata("version")? {
            VERSION if !has_checksums => return Err(broken(format!("metadata entry \"{CHECKSUMS}\" is missing"))),
            VERSION | VERSION_UNCHECKED => {}
            other => {
                let expected = format!("expected \"{VERSION_UNCHECKED}\" or \"{VERSION}\"");
                return Err(broken(format!("metadata entry \"version\": {expected}, got \"{other}\"")));
            }
        }
        let license = reader.metadata("license")?.to_owned();
        let known: Vec<&str> = CONVENTIONS.iter().map(|convention| convention.0).chain(OWN_METADATA).collect();
        let facts = reader.other_metadata(&known);
        if reader.has_metadata("architecture") {
            let graph = Self::read_photo_graph(&mut reader)?;
            return Ok(Self { facts, has_checksums, ..Self::from_photo_graph(graph, license) });
        }
        let configs: Vec<NetworkConfig> = serde_json::from_str(reader.metadata("networks")?)
            .map_err(|error| broken(format!("metadata entry \"networks\": {error}")))?;
        check_together(&configs)?;
        check_channels(&reader, configs[0].lobe)?;
        let named = |config: &NetworkConfig| {
            let prefix = prefix(config);
            config.all_tensors().map(move |name| format!("{prefix}{name}")).collect::<Vec<_>>()
        };
        check_names(&reader, configs.iter().flat_map(named))?;

        let mut chosen = configs;
        if let Some(photos) = photos {
            let fewest = chosen.iter().map(|config| config.photos).min().unwrap_or(0);
            let most = chosen.iter().map(|config| config.photos).filter(|&needed| needed <= photos).max();
            let most = most.ok_or_else(|| too_few(fewest, photos))?;
            chosen.retain(|config| config.photos == most);
        }
        let networks = chosen.into_iter().map(|config| {
            let prefix = prefix(&config);
            Network::new(config, |name, shape| reader.read(&format!("{prefix}{name}"), shape))
        });
        Ok(Self { has_checksums, ..Self::from_networks(networks.collect::<Result<_>>()?, license, facts) })
    }

    fn read_photo_graph(reader: &mut Reader<impl Read + Seek>) -> Result<PhotoGraph> {
        let config = PhotoGraphConfig::parse(reader.metadata("architecture")?)?;
        check_channels(reader, Lobe::Isotropic)?;
        check_names(reader, config.tensors().into_iter().map(|tensor| tensor.0))?;
        PhotoGraph::new(config, |name, shape| reader.read(name, shape))
    }

    fn metadata(&self) -> std::result::Result<HashMap<String, String>, serde_json::Error> {
        let mut metadata: HashMap<String, String> = self.facts.clone().into_iter().collect();
        metadata.extend(CONVENTIONS.iter().map(|&(key, value)| (key.into(), value.into())));
        metadata.insert("version".into(), VERSION.into());
        metadata.insert("license".into(), self.license.clone());
        let lobe = match &self.content {
            Content::Networks(networks) => {
                let configs: Vec<_> = networks.iter().map(|network| &network.config).collect();
                metadata.insert("networks".into(), serde_json::to_string(&configs)?);
                configs.first().map_or(Lobe::Isotropic, |first| first.lobe)
            }
            Content::PhotoGraph(graph) => {
                metadata.insert("architecture".into(), graph.config().architecture()?.to_string());
                Lobe::Isotropic
            }
        };
        metadata.insert("channels".into(), channel_order(lobe).into());
        Ok(metadata)
    }
}

/// Fails unless the file states the order of channels that `lobe` has.
fn check_channels(reader: &Reader<impl Read + Seek>, lobe: Lobe) -> Result<()> {
    let (expected, got) = (channel_order(lobe), reader.metadata("channels")?);
    if got == expected {
        return Ok(());
    }
    Err(broken(format!("metadata entry \"channels\": expected \"{expected}\", got \"{got}\"")))
}

/// Fails unless the file's tensors are exactly those named.
fn check_names(reader: &Reader<impl Read + Seek>, expected: impl Iterator<Item = String>) -> Result<()> {
    let mut unknown = reader.names();
    for name in expected {
        if !unknown.remove(&name) {
            return Err(broken(format!("tensor {name} is missing")));
        }
    }
    match unknown.first() {
        Some(name) => Err(broken(format!("tensor {name:?} belongs to no network"))),
        None => Ok(()),
    }
}

fn too_few(needed: usize, got: usize) -> Error {
    broken(format!("the network for the fewest photos needs {needed}, got {got}"))
}

fn prefix(config: &NetworkConfig) -> String {
    format!("photos{}.", config.photos)
}

/// Fails unless these networks can share a file.
fn check_together(configs: &[NetworkConfig]) -> Result<()> {
    let Some(first) = configs.first() else { return Err(broken("holds no network")) };
    for (i, config) in configs.iter().enumerate() {
        config.validate()?;
        if configs[..i].iter().any(|other| other.photos == config.photos) {
            return Err(broken(format!("holds two networks for {} photos", config.photos)));
        }
        if config.lobe != first.lobe {
            return Err(broken("holds isotropic and anisotropic networks"));
        }
    }
    Ok(())
}

/// Fixed values for a parameter, of a size that keeps signals alive through the layers.
pub(super) fn random_tensor(name: &str, shape: &[usize], state: &mut u64) -> Vec<f32> {
    let len = shape.iter().product();
    if name.contains("norm") && name.ends_with("weight") || name.ends_with("adj1") {
        return vec![1.0; len];
    }
    if name.ends_with("lamda") {
        return vec![0.1; len];
    }
    let inputs: usize = shape.iter().skip(1).product();
    let scale = if name.ends_with("weight") { (3.0 / inputs as f32).sqrt() } else { 0.2 };
    let mut next = || {
        // SplitMix64.
        *state = state.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut bits = *state;
        bits = (bits ^ (bits >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        bits = (bits ^ (bits >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        ((bits ^ (bits >> 31)) >> 40) as f32 / (1u64 << 23) as f32 - 1.0
    };
    (0..len).map(|_| scale * next()).collect()
}

/// One encoder with its decoder and adapters.
pub struct Network {
    config: NetworkConfig,
    tensors: BTreeMap<String, Arc<Vec<f32>>>,
    adapters: Vec<AdapterParams>,
    encoder: Encoder<f32>,
    decoder: Decoder<f32>,
}

impl std::fmt::Debug for Network {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_tuple("Network").field(&self.config).finish()
    }
}

/// What the encoder makes of photos.
#[derive(Clone)]
pub struct Code {
    /// The latent code, plane after plane.
    pub latent: Vec<f32>,
    layout: Layout,
    skips: Vec<Arc<Planes<f32>>>,
    /// Runs of the decoder on this code share their memory.
    pool: Pool<f32>,
    height: usize,
    width: usize,
}

impl Code {
    /// Rows of the photos.
    pub fn height(&self) -> usize {
        self.height
    }

    /// Columns of the photos.
    pub fn width(&self) -> usize {
        self.width
    }

    /// What level `level` of the encoder, 0 the finest, hands to the decoder, plane after plane: channels times rows times columns,
    /// photo rows and columns rounded up to multiples of 2^levels and divided by 2^level.
    pub fn skip(&self, level: usize) -> Option<Vec<f32>> {
        let planes = self.skips.get(level)?;
        Some(planes.layout.unpack(planes.values(), planes.layout.height, planes.layout.width))
    }
}

/// A run of the decoder whose gradient can be taken back.
pub struct DecoderTrace {
    trace: Trace<f32>,
    layout: Layout,
    height: usize,
    width: usize,
}

impl DecoderTrace {
    /// The gradient with respect to the latent code, plane after plane, given that with respect to the material feature.
    ///
    /// # Errors
    /// [`Error::ShapeMismatch`] if `gradient` has not the feature's length; [`Error::Cancelled`].
    pub fn pull_back(self, gradient: &[f32], control: &mut Control<'_>) -> Result<Vec<f32>> {
        let layout = self.trace.feature.layout;
        expect_len("gradient", gradient.len(), layout.channels * self.height * self.width)?;
        let gradient = layout.pack(gradient, self.height, self.width);
        let latent = self.trace.pull_back(gradient, control)?;
        Ok(self.layout.unpack(&latent, self.layout.height, self.layout.width))
    }

    /// What `loss` computes on dfdx's tape from the material feature, and its gradient with respect to the latent code, plane after plane.
    ///
    /// # Errors
    /// As `loss`; [`Error::Cancelled`].
    pub(crate) fn descend(
        self,
        loss: impl FnOnce(Image<f32, Recording<f32>>) -> Result<Loss<f32>>,
        control: &mut Control<'_>,
    ) -> Result<(f64, Vec<f32>)> {
        let Self { trace, layout, height, width } = self;
        let (value, latent) = trace.descend(|feature| loss(unpacked(feature, height, width)?), control)?;
        Ok((value.into(), layout.unpack(&latent, layout.height, layout.width)))
    }
}

fn expect_len(name: &str, got: usize, expected: usize) -> Result<()> {
    if got == expected {
        Ok(())
    } else {
        Err(Error::shape(name, format!("{expected} values"), format!("{got} values")))
    }
}

impl Network {
    /// A network whose tensors `get` gives by name and shape.
    fn new(config: NetworkConfig, mut get: impl FnMut(&str, &[usize]) -> Result<Vec<f32>>) -> Result<Self> {
        let mut tensors = BTreeMap::new();
        for (name, shape) in config.tensors() {
            let values = Arc::new(get(&name, &shape)?);
            tensors.insert(name, values);
        }
        let mut adapters = Vec::new();
        for &(name, outputs) in config.adapters() {
            let mut values = Vec::new();
            for (name, shape, _) in config.adapter_tensors(name, outputs) {
                values.extend(get(&name, &shape)?);
            }
            adapters.push(AdapterParams::new(config.feature_channels(), outputs, values)?);
        }
        let mut param = |name: &str| match tensors.get(name) {
            Some(values) => Ok(Param::constant(values.clone())),
            None => Err(broken(format!("tensor {name} is missing"))),
        };
        let (encoder, decoder) = (Encoder::new(&config, &mut param)?, Decoder::new(&config, &mut param)?);
        Ok(Self { encoder, decoder, config, tensors, adapters })
    }

    fn for_each_tensor<'a>(&'a self, mut visit: impl FnMut(&str, Vec<usize>, &'a [f32])) {
        for (name, shape) in self.config.tensors() {
            if let Some(values) = self.tensors.get(&name) {
                visit(&name, shape, values);
            }
        }
        for (&(name, outputs), adapter) in self.config.adapters().iter().zip(&self.adapters) {
            for (name, shape, range) in self.config.adapter_tensors(name, outputs) {
                visit(&name, shape, &adapter.values[range]);
            }
        }
    }

    /// Sizes and form.
    pub fn config(&self) -> &NetworkConfig {
        &self.config
    }

    /// How many parameters there are, those of the adapters included.
    pub fn parameters(&self) -> usize {
        let mut count = 0;
        self.for_each_tensor(|_, _, values| count += values.len());
        count
    }

    /// Estimated bytes that encoding and optimising at `height` x `width` pixels take beyond the parameters.
    pub(crate) fn fit_memory(&self, height: usize, width: usize) -> u64 {
        let config = &self.config;
        let unit = 1u64 << config.levels();
        let pixels = (height as u64).next_multiple_of(unit) * (width as u64).next_multiple_of(unit);
        // One set of feature planes at the finest level; every coarser level has half of it.
        let planes = 4 * config.width as u64 * pixels;
        let at = |level: usize, blocks: usize| blocks as u64 * (planes >> level);
        let decoder =
            config.decoder_blocks.iter().rev().enumerate().map(|(level, &blocks)| at(level, blocks)).sum::<u64>()
                + at(config.levels(), config.middle_blocks);
        let skips = 2 * planes;
        // Adapters: input, states of the block and their gradients, raw planes and maps; on the tape input, raw planes and maps with theirs.
        let feature = 4 * config.feature_channels() as u64 * pixels;
        STORED_PER_BLOCK * decoder
            + skips
            + WORKING_PLANES * planes
            + feature * (10 + 6 * config.adapters().len() as u64)
    }

    /// The adapters in the order of their outputs: diffuse, normal, roughness, specular, and tangent if anisotropic.
    pub fn adapters(&self) -> &[AdapterParams] {
        &self.adapters
    }

    /// Encodes photos of `height` x `width` pixels: as many as the network takes, each three planes R, G, B, encoded with gamma 2.2, [0, 1].
    ///
    /// Sides that are no multiple of 2^levels are continued with zeros to the right and below.
    ///
    /// # Errors
    /// [`Error::ShapeMismatch`] if the number of photos or a length differs, or a side is zero; [`Error::Cancelled`].
    pub fn encode(&self, photos: &[&[f32]], height: usize, width: usize, control: &mut Control<'_>) -> Result<Code> {
        if photos.len() != self.config.photos {
            return Err(Error::shape("photos", self.config.photos.to_string(), photos.len().to_string()));
        }
        let pixels = height.checked_mul(width).filter(|&pixels| pixels > 0 && pixels < 1 << 40);
        let pixels =
            pixels.ok_or_else(|| Error::shape("photo", "1 x 1 pixels or more", format!("{height} x {width}")))?;
        for photo in photos {
            expect_len("photo", photo.len(), 3 * pixels)?;
        }
        let unit = 1 << self.config.levels();
        let layout = Layout {
            channels: 3 * photos.len(),
            height: height.next_multiple_of(unit),
            width: width.next_multiple_of(unit),
        };
        let pool = Pool::default();
        let photos = Planes::pooled(layout.pack(&photos.concat(), height, width), layout, &pool)?;
        let Encoded { latent, skips } = self.encoder.run(photos, control)?;
        let layout = latent.layout;
        let latent = layout.unpack(latent.values(), layout.height, layout.width);
        Ok(Code { latent, layout, skips: skips.into_iter().map(Arc::new).collect(), pool, height, width })
    }

    /// The material feature, (9 or 14, H, W) plane after plane, of `latent` with the skips of `code`.
    ///
    /// # Errors
    /// [`Error::ShapeMismatch`] if `latent` has not the length of `code`'s; [`Error::Cancelled`].
    pub fn decode(&self, latent: &[f32], code: &Code, control: &mut Control<'_>) -> Result<Vec<f32>> {
        let feature = self.decoder.run(self.start(latent, code)?, &skips(code), control)?;
        Ok(feature.layout.unpack(feature.values(), code.height, code.width))
    }

    /// As [`Network::decode`], and what takes a gradient back to the latent code.
    ///
    /// # Errors
    /// As [`Network::decode`].
    pub fn decode_traced(
        &self,
        latent: &[f32],
        code: &Code,
        control: &mut Control<'_>,
    ) -> Result<(Vec<f32>, DecoderTrace)> {
        let trace = self.decoder.run_traced(self.start(latent, code)?, &skips(code), control)?;
        let feature = trace.feature.layout.unpack(trace.feature.values(), code.height, code.width);
        Ok((feature, DecoderTrace { trace, layout: code.layout, height: code.height, width: code.width }))
    }

    fn start(&self, latent: &[f32], code: &Code) -> Result<Planes<f32>> {
        expect_len("latent", latent.len(), code.layout.len())?;
        if code.layout.channels != self.config.latent_channels() || code.skips.len() != self.config.levels() {
            return Err(Error::invalid("code", "comes from another network"));
        }
        let latent = code.layout.pack(latent, code.layout.height, code.layout.width);
        Planes::pooled(latent, code.layout, &code.pool)
    }
}

fn skips(code: &Code) -> Vec<Planes<f32>> {
    code.skips.iter().map(|skip| skip.branch()).collect()
}

/// What tests of weights files share.
#[cfg(test)]
pub(super) mod testing {
    use super::Model;
    use crate::error::Error;

    /// The file with its header changed by `edit`.
    pub fn edited(file: &[u8], edit: impl FnOnce(&mut serde_json::Map<String, serde_json::Value>)) -> Vec<u8> {
        let len = u64::from_le_bytes(*file.first_chunk().unwrap()) as usize;
        let mut header: serde_json::Map<_, _> = serde_json::from_slice(&file[8..8 + len]).unwrap();
        // As a file without checksums, so that what is edited is looked at itself.
        let metadata = header["__metadata__"].as_object_mut().unwrap();
        metadata.remove(super::CHECKSUMS);
        metadata["version"] = super::VERSION_UNCHECKED.into();
        edit(&mut header);
        let header = serde_json::to_vec(&header).unwrap();
        [&(header.len() as u64).to_le_bytes()[..], &header, &file[8 + len..]].concat()
    }

    pub fn reason(file: &[u8]) -> String {
        match Model::from_bytes(file) {
            Err(Error::Weights { reason }) => reason,
            other => panic!("{other:?}"),
        }
    }
}

#[cfg(test)]
mod tests {
    use std::ops::ControlFlow;

    use super::testing::{edited, reason};
    use super::{Model, NetworkConfig};
    use crate::error::Error;
    use crate::maps::Lobe;
    use crate::nn::config::Gcn;
    use crate::progress::{CancelToken, Control, Progress};

    fn small(photos: usize, gcn: Gcn) -> NetworkConfig {
        NetworkConfig {
            photos,
            width: 4,
            encoder_blocks: vec![1, 1],
            middle_blocks: 1,
            decoder_blocks: vec![1, 1],
            gcn,
            lobe: Lobe::Isotropic,
            roughness_floor: -0.3,
        }
    }

    fn model() -> Model {
        Model::random(&[small(4, Gcn::Full), small(1, Gcn::None)], 7).unwrap()
    }

    fn saved(model: &Model) -> Vec<u8> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("weights.safetensors");
        model.save(&path).unwrap();
        std::fs::read(path).unwrap()
    }

    fn encode_and_decode(model: &Model, photos: usize, height: usize, width: usize) -> Vec<f32> {
        let mut callback = |_: &Progress| ControlFlow::Continue(());
        let mut control = Control::new(&mut callback, CancelToken::new());
        let network = model.network(photos).unwrap();
        let photo: Vec<f32> = (0..3 * height * width).map(|i| (i as f32 * 0.7).sin().abs()).collect();
        let photos = vec![&photo[..]; network.config().photos];
        let code = network.encode(&photos, height, width, &mut control).unwrap();
        let feature = network.decode(&code.latent, &code, &mut control).unwrap();
        let (traced, trace) = network.decode_traced(&code.latent, &code, &mut control).unwrap();
        assert_eq!(feature, traced);
        assert_eq!(trace.pull_back(&feature, &mut control).unwrap().len(), code.latent.len());
        feature
    }

    #[test]
    fn is_shared_between_threads() {
        fn check<T: Send + Sync>() {}
        check::<Model>();
        check::<super::Code>();
    }

    #[test]
    fn saved_and_loaded_again() {
        let model = model();
        let file = saved(&model);
        let again = Model::from_bytes(&file).unwrap();
        assert_eq!(again.license(), model.license());
        // The header lists the metadata in any order.
        let data = |file: &[u8]| file[8 + u64::from_le_bytes(*file.first_chunk().unwrap()) as usize..].to_vec();
        assert!(data(&saved(&again)) == data(&file), "tensors changed");
        assert_eq!(encode_and_decode(&again, 4, 8, 12), encode_and_decode(&model, 4, 8, 12));
    }

    #[test]
    fn loads_only_what_a_fit_takes() {
        let file = tempfile::NamedTempFile::new().unwrap();
        let model = Model::random(&[small(2, Gcn::Full), small(4, Gcn::Diagonal)], 7).unwrap();
        model.save(file.path()).unwrap();
        for (photos, expected) in [(2, 2), (3, 2), (4, 4), (9, 4)] {
            let loaded = Model::load_for(file.path(), photos).unwrap();
            assert_eq!(loaded.networks().len(), 1);
            assert_eq!(loaded.networks()[0].config().photos, expected);
            assert_eq!(encode_and_decode(&loaded, photos, 4, 4), encode_and_decode(&model, photos, 4, 4));
        }
        let message = Model::load_for(file.path(), 1).unwrap_err().to_string();
        assert!(message.contains("needs 2, got 1"), "{message}");
        assert!(matches!(Model::load("no such file"), Err(Error::Io { .. })));
    }

    #[test]
    fn half_precision() {
        let file = saved(&model());
        let file = edited(&file, |_| {});
        let len = u64::from_le_bytes(*file.first_chunk().unwrap()) as usize;
        let mut header: serde_json::Map<String, serde_json::Value> = serde_json::from_slice(&file[8..8 + len]).unwrap();
        for (name, entry) in &mut header {
            if name != "__metadata__" {
                entry["dtype"] = "F16".into();
                for offset in entry["data_offsets"].as_array_mut().unwrap() {
                    *offset = (offset.as_u64().unwrap() / 2).into();
                }
            }
        }
        let header = serde_json::to_vec(&header).unwrap();
        let floats = file[8 + len..].as_chunks().0.iter().map(|&value| f32::from_le_bytes(value));
        let data: Vec<u8> = floats.flat_map(|value| half::f16::from_f32(value).to_le_bytes()).collect();
        let loaded = Model::from_bytes(&[&(header.len() as u64).to_le_bytes()[..], &header, &data].concat()).unwrap();
        let (got, expected) = (encode_and_decode(&loaded, 1, 4, 4), encode_and_decode(&model(), 1, 4, 4));
        let off = got.iter().zip(&expected).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
        assert!(off > 0.0 && off < 2e-2, "{off}");
    }

    #[test]
    fn any_size_of_photo() {
        for (height, width) in [(1, 1), (5, 7), (4, 9), (13, 4)] {
            let feature = encode_and_decode(&model(), 4, height, width);
            assert_eq!(feature.len(), 9 * height * width);
            assert!(feature.iter().all(|value| value.is_finite()));
        }
    }

    #[test]
    fn wrong_photos_and_codes_are_errors() {
        let model = model();
        let mut callback = |_: &Progress| ControlFlow::Continue(());
        let mut control = Control::new(&mut callback, CancelToken::new());
        let (one, four) = (model.network(1).unwrap(), model.network(4).unwrap());
        let photo = [0.5; 48];
        let code = one.encode(&[&photo], 4, 4, &mut control).unwrap();
        for (photos, height, width) in
            [(vec![], 4, 4), (vec![&photo[..]; 2], 4, 4), (vec![&photo[..]], 4, 5), (vec![&[]], 0, 4)]
        {
            assert!(one.encode(&photos, height, width, &mut control).is_err());
        }
        assert!(one.encode(&[&photo], usize::MAX, usize::MAX, &mut control).is_err());
        assert!(one.decode(&code.latent[1..], &code, &mut control).is_err());
        assert!(four.decode(&code.latent, &code, &mut control).is_ok(), "same sizes");
        let other = Model::random(&[NetworkConfig { width: 8, ..small(1, Gcn::None) }], 1).unwrap();
        assert!(other.network(1).unwrap().decode(&code.latent, &code, &mut control).is_err());
        let (_, trace) = one.decode_traced(&code.latent, &code, &mut control).unwrap();
        assert!(trace.pull_back(&[0.0; 5], &mut control).is_err());
        drop(control);
        let mut stop = |_: &Progress| ControlFlow::Break(());
        let mut control = Control::new(&mut stop, CancelToken::new());
        assert!(matches!(one.decode(&code.latent, &code, &mut control), Err(Error::Cancelled)));
        assert!(matches!(one.encode(&[&photo], 4, 4, &mut control), Err(Error::Cancelled)));
    }

    #[test]
    fn other_conventions_are_refused() {
        let file = saved(&model());
        for key in ["format", "version", "brdf", "roughness", "color_space", "channels", "license", "networks"] {
            let without = edited(&file, |header| {
                header["__metadata__"].as_object_mut().unwrap().remove(key);
            });
            assert!(reason(&without).contains(key), "{key}");
            if key != "license" {
                let other = edited(&file, |header| header["__metadata__"][key] = "other".into());
                assert!(reason(&other).contains(key), "{key}");
            }
        }
    }

    #[test]
    fn damaged_files_are_refused() {
        let file = saved(&model());
        for len in (0..file.len()).step_by(101).chain([file.len() - 1]) {
            reason(&file[..len]);
        }
        reason(&[&file[..], &[0]].concat());
        reason(&u64::MAX.to_le_bytes());
        reason(&[&(100u64 << 30).to_le_bytes()[..], b"{}"].concat());
        let tensor = "photos4.encoder.conv0.bias";
        assert!(
            reason(&edited(&file, |header| {
                let entry = header.remove(tensor).unwrap();
                header.insert("surplus".into(), entry);
            }))
            .contains(tensor)
        );
        for (key, value) in [
            ("dtype", serde_json::json!("I32")),
            ("dtype", serde_json::json!("nonsense")),
            ("shape", serde_json::json!([2])),
            ("shape", serde_json::json!([1u64 << 40, 1u64 << 40])),
            ("shape", serde_json::json!([-1])),
            ("data_offsets", serde_json::json!([0, u64::MAX])),
            ("data_offsets", serde_json::json!([4, 0])),
        ] {
            reason(&edited(&file, |header| header[tensor][key] = value));
        }
        let huge = NetworkConfig {
            width: 1024,
            encoder_blocks: vec![64; 6],
            decoder_blocks: vec![64; 6],
            ..small(4, Gcn::Full)
        };
        reason(&edited(&file, |header| {
            header["__metadata__"]["networks"] = serde_json::to_string(&[huge]).unwrap().into();
        }));
        let mut infinite = edited(&file, |_| {});
        let end = infinite.len();
        infinite[end - 4..].copy_from_slice(&f32::INFINITY.to_le_bytes());
        assert!(reason(&infinite).contains("inf"));
    }

    /// Bits are flipped one at a time, in the header and in the tensors: every one is found.
    #[test]
    fn a_flipped_bit_is_found() {
        let mut file = saved(&model());
        let header = 8 + u64::from_le_bytes(*file.first_chunk().unwrap()) as usize;
        let places = (0..header).step_by(3).chain((header..file.len()).step_by(61)).chain([file.len() - 1]);
        for place in places {
            let bit = 1 << (place * 7 % 8);
            file[place] ^= bit;
            reason(&file);
            file[place] ^= bit;
        }
        assert!(Model::from_bytes(&file).unwrap().has_checksums());
        // The lowest bit of a value, which no other check would see.
        let last = file.len() - 4;
        file[last] ^= 1;
        let message = reason(&file);
        assert!(message.contains("tensor photos") && message.contains("checksum"), "{message}");
    }

    #[test]
    fn files_without_checksums_load_and_say_so() {
        let file = saved(&model());
        let old = Model::from_bytes(&edited(&file, |_| {})).unwrap();
        assert!(!old.has_checksums());
        assert_eq!(encode_and_decode(&old, 1, 4, 4), encode_and_decode(&model(), 1, 4, 4));
        // Only files of before may lack them, and none may lack one.
        let without = edited(&file, |header| header["__metadata__"]["version"] = super::VERSION.into());
        assert!(reason(&without).contains("checksums"));
        let empty = r#"{"metadata": "00000000", "tensors": {}}"#;
        let wrong = edited(&file, |header| header["__metadata__"][super::CHECKSUMS] = empty.into());
        assert!(reason(&wrong).contains("the file states 00000000"), "{}", reason(&wrong));
    }

    #[test]
    fn two_networks_for_the_same_photos_are_refused() {
        assert!(Model::random(&[small(1, Gcn::None), small(1, Gcn::Full)], 0).is_err());
        assert!(Model::random(&[], 0).is_err());
        let anisotropic = NetworkConfig { lobe: Lobe::Anisotropic, ..small(4, Gcn::Full) };
        assert!(Model::random(&[small(1, Gcn::None), anisotropic], 0).is_err());
    }
}
