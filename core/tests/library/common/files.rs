//! Image files written byte by byte, so that the readers are not tested against the encoders of their own crates.

/// A PNG of 8- or 16-bit samples (each `u16` is one sample), uncompressed. `kind`: 0 grey, 2 RGB, 4 grey and alpha, 6 RGB and alpha.
pub fn png(width: u32, height: u32, kind: u8, depth: u8, samples: &[u16]) -> Vec<u8> {
    png_with(width, height, kind, depth, samples, &[])
}

/// [`png`] with `chunks` before the pixels.
pub fn png_with(
    width: u32,
    height: u32,
    kind: u8,
    depth: u8,
    samples: &[u16],
    chunks: &[(&[u8; 4], Vec<u8>)],
) -> Vec<u8> {
    let channels = [1, 0, 3, 0, 2, 0, 4][usize::from(kind)];
    assert_eq!(samples.len(), (width * height) as usize * channels);
    let mut raw = Vec::new();
    for row in samples.chunks(width as usize * channels) {
        raw.push(0);
        for &sample in row {
            match depth {
                8 => raw.push(u8::try_from(sample).unwrap()),
                _ => raw.extend(sample.to_be_bytes()),
            }
        }
    }
    let mut zlib = vec![0x78, 0x01];
    let blocks: Vec<_> = raw.chunks(0xffff).collect();
    for (i, block) in blocks.iter().enumerate() {
        let length = block.len() as u16;
        zlib.push(u8::from(i + 1 == blocks.len()));
        zlib.extend(length.to_le_bytes());
        zlib.extend((!length).to_le_bytes());
        zlib.extend(*block);
    }
    let (a, b) = raw.iter().fold((1u32, 0u32), |(a, b), &v| {
        let a = (a + u32::from(v)) % 65521;
        (a, (b + a) % 65521)
    });
    zlib.extend((b << 16 | a).to_be_bytes());

    let mut header = Vec::new();
    header.extend(width.to_be_bytes());
    header.extend(height.to_be_bytes());
    header.extend([depth, kind, 0, 0, 0]);
    let mut file = b"\x89PNG\r\n\x1a\n".to_vec();
    let mut all = vec![(b"IHDR", header)];
    all.extend(chunks.iter().cloned());
    all.extend([(b"IDAT", zlib), (b"IEND", Vec::new())]);
    for (name, data) in all {
        file.extend((data.len() as u32).to_be_bytes());
        let start = file.len();
        file.extend(name);
        file.extend(data);
        let crc = crc32(&file[start..]);
        file.extend(crc.to_be_bytes());
    }
    file
}

fn crc32(bytes: &[u8]) -> u32 {
    !bytes
        .iter()
        .fold(!0u32, |crc, &byte| (0..8).fold(crc ^ u32::from(byte), |crc, _| (crc >> 1) ^ (0xedb8_8320 * (crc & 1))))
}

/// A little-endian TIFF in one strip. `format`: 1 unsigned integer, 3 float; `data` are the bytes of the samples.
pub fn tiff(width: u32, height: u32, channels: u16, bits: u16, format: u16, orientation: u16, data: &[u8]) -> Vec<u8> {
    assert_eq!(data.len(), width as usize * height as usize * usize::from(channels) * usize::from(bits / 8));
    let mut file = b"II\x2a\0".to_vec();
    let mut extra = Vec::new();
    let entries: u32 = 12;
    let extra_start = 8 + 2 + entries * 12 + 4;
    let mut list = |value: u16| {
        let at = extra_start + extra.len() as u32;
        extra.extend((0..channels).flat_map(|_| value.to_le_bytes()));
        if channels <= 2 { u32::from(value) | if channels == 2 { u32::from(value) << 16 } else { 0 } } else { at }
    };
    let bits_value = list(bits);
    let format_value = list(format);
    let data_start = extra_start + extra.len() as u32;
    let photometric = if channels >= 3 { 2 } else { 1 };
    file.extend(8u32.to_le_bytes());
    file.extend((entries as u16).to_le_bytes());
    let alpha = channels.is_multiple_of(2);
    for (tag, kind, count, value) in [
        (256u16, 4u16, 1u32, width),
        (257, 4, 1, height),
        (258, 3, channels.into(), bits_value),
        (259, 3, 1, 1),
        (262, 3, 1, photometric),
        (273, 4, 1, data_start),
        (274, 3, 1, orientation.into()),
        (277, 3, 1, channels.into()),
        (278, 4, 1, height),
        (279, 4, 1, data.len() as u32),
        (if alpha { 338 } else { 305 }, if alpha { 3 } else { 2 }, 1, if alpha { 2 } else { 0 }),
        (339, 3, channels.into(), format_value),
    ] {
        file.extend(tag.to_le_bytes());
        file.extend(kind.to_le_bytes());
        file.extend(count.to_le_bytes());
        file.extend(value.to_le_bytes());
    }
    file.extend(0u32.to_le_bytes());
    file.extend(extra);
    file.extend(data);
    file
}

/// The bits of the sample at x, y, channel.
pub type Sample = fn(usize, usize, usize) -> u64;

/// A page of a TIFF, laid out as its fields say.
#[derive(Clone, Copy, Debug)]
pub struct Tiff {
    pub width: usize,
    pub height: usize,
    /// 1 or 3.
    pub colors: usize,
    /// Samples beyond colour.
    pub extra: usize,
    /// What the first of them is: 0 nothing known, 1 and 2 alpha.
    pub extra_kind: u64,
    /// 8, 16, 32 or 64.
    pub bits: usize,
    pub float: bool,
    /// 1 none, 5 LZW, 7 JPEG, 8 deflate, 32773 PackBits.
    pub compression: u64,
    /// 1 none, 2 differences, 3 that of floats; for LZW and deflate.
    pub predictor: u64,
    pub planar: bool,
    /// The side of tiles; 0 for strips.
    pub tile: usize,
    /// Rows of a strip.
    pub rows: usize,
    /// Bytes of a number from the highest to the lowest.
    pub big_endian: bool,
    /// The form for files above 4 GiB.
    pub big_tiff: bool,
    /// LZW: the closing code of every stream.
    pub closed: bool,
    pub photometric: u64,
    /// NewSubfileType: 1 for a reduced page.
    pub subfile: u64,
    /// Rows that the data of a single strip hold, if not those of the page.
    pub stored_rows: Option<usize>,
    /// An ICC profile; none if empty.
    pub profile: &'static [u8],
    pub sample: Sample,
}

impl Tiff {
    /// RGB of 16 bits in one strip.
    pub const RGB16: Self = Self {
        width: 37,
        height: 21,
        colors: 3,
        extra: 0,
        extra_kind: 0,
        bits: 16,
        float: false,
        compression: 1,
        predictor: 1,
        planar: false,
        tile: 0,
        rows: usize::MAX,
        big_endian: false,
        big_tiff: false,
        closed: true,
        photometric: 2,
        subfile: 0,
        stored_rows: None,
        profile: &[],
        sample: |x, y, c| (x * 1543 + y * 377 + c * 20011) as u64 % 65536,
    };

    pub fn file(&self) -> Vec<u8> {
        tiff_pages(&[*self], &[])
    }

    fn bytes(&self, value: u64, count: usize) -> Vec<u8> {
        if self.big_endian { value.to_be_bytes()[8 - count..].to_vec() } else { value.to_le_bytes()[..count].to_vec() }
    }

    /// The chunks as the file has them, plane after plane.
    fn chunks(&self) -> Vec<Vec<u8>> {
        let height = self.stored_rows.unwrap_or(self.height);
        let (chunk_width, chunk_height) =
            if self.tile > 0 { (self.tile, self.tile) } else { (self.width, self.rows.min(height)) };
        let samples = self.colors + self.extra;
        let planes: Vec<Vec<usize>> =
            if self.planar { (0..samples).map(|c| vec![c]).collect() } else { vec![(0..samples).collect()] };
        let mut chunks = Vec::new();
        for plane in &planes {
            for top in (0..height).step_by(chunk_height) {
                for left in (0..self.width).step_by(chunk_width) {
                    let rows = if self.tile > 0 { chunk_height } else { chunk_height.min(height - top) };
                    let mut data = Vec::new();
                    for y in top..top + rows {
                        let mut row: Vec<u64> = Vec::new();
                        for x in left..left + chunk_width {
                            let inside = x < self.width && y < height;
                            row.extend(plane.iter().map(|&c| if inside { (self.sample)(x, y, c) } else { 0 }));
                        }
                        data.extend(self.row(&row, plane.len()));
                    }
                    chunks.push(self.packed(&data));
                }
            }
        }
        chunks
    }

    /// The bytes of a row after the predictor.
    fn row(&self, samples: &[u64], stride: usize) -> Vec<u8> {
        let size = self.bits / 8;
        match self.predictor {
            2 => (0..samples.len())
                .map(|i| if i < stride { samples[i] } else { samples[i].wrapping_sub(samples[i - stride]) })
                .flat_map(|sample| self.bytes(sample, size))
                .collect(),
            3 => {
                let planes: Vec<u8> = (0..size)
                    .flat_map(|byte| samples.iter().map(move |sample| sample.to_be_bytes()[8 - size + byte]))
                    .collect();
                (0..planes.len())
                    .map(|i| if i < stride { planes[i] } else { planes[i].wrapping_sub(planes[i - stride]) })
                    .collect()
            }
            _ => samples.iter().flat_map(|&sample| self.bytes(sample, size)).collect(),
        }
    }

    fn packed(&self, data: &[u8]) -> Vec<u8> {
        match self.compression {
            1 => data.to_vec(),
            5 => packed_lzw(data, self.closed),
            8 => {
                let mut encoder = flate2::write::ZlibEncoder::new(Vec::new(), flate2::Compression::fast());
                std::io::Write::write_all(&mut encoder, data).unwrap();
                encoder.finish().unwrap()
            }
            32773 => packed_bits(data),
            7 => {
                let (mut out, width) = (Vec::new(), if self.tile > 0 { self.tile } else { self.width });
                let rows = data.len() / width / self.colors;
                let color =
                    if self.colors == 3 { image::ExtendedColorType::Rgb8 } else { image::ExtendedColorType::L8 };
                let mut encoder = image::codecs::jpeg::JpegEncoder::new_with_quality(&mut out, 95);
                encoder.encode(data, width as u32, rows as u32, color).unwrap();
                out
            }
            other => panic!("no encoder for compression {other}"),
        }
    }
}

fn packed_lzw(data: &[u8], closed: bool) -> Vec<u8> {
    let mut encoder = weezl::encode::Encoder::with_tiff_size_switch(weezl::BitOrder::Msb, 8);
    if closed {
        return encoder.encode(data).unwrap();
    }
    let mut out = vec![0; 2 * data.len() + 64];
    let written = encoder.encode_bytes(data, &mut out).consumed_out;
    // What is left in the encoder are a code or two: they are written with the closing code, which is cut off.
    encoder.finish();
    let rest = encoder.encode_bytes(&[], &mut out[written..]).consumed_out;
    out.truncate(written + rest - 1);
    out
}

/// Runs of at least three equal bytes, and literals between them.
fn packed_bits(data: &[u8]) -> Vec<u8> {
    let mut out = Vec::new();
    let mut literal: Vec<u8> = Vec::new();
    let mut at = 0;
    while at < data.len() {
        let run = data[at..].iter().take(128).take_while(|&&byte| byte == data[at]).count();
        if run < 3 && literal.len() < 128 {
            literal.push(data[at]);
            at += 1;
            continue;
        }
        if !literal.is_empty() {
            out.push(literal.len() as u8 - 1);
            out.append(&mut literal);
        }
        if run >= 3 {
            out.extend([(1 - run as i32) as u8, data[at]]);
            at += run;
        }
    }
    if !literal.is_empty() {
        out.push(literal.len() as u8 - 1);
        out.append(&mut literal);
    }
    out
}

/// A TIFF of the pages `chain`, with those in `below` under the first one. All have the byte order and form of the first.
pub fn tiff_pages(chain: &[Tiff], below: &[Tiff]) -> Vec<u8> {
    let head = chain[0];
    let bytes = |value: u64, count: usize| head.bytes(value, count);
    let word = if head.big_tiff { 8 } else { 4 };
    let mut file = if head.big_endian { b"MM".to_vec() } else { b"II".to_vec() };
    file.extend(bytes(if head.big_tiff { 43 } else { 42 }, 2));
    if head.big_tiff {
        file.extend([bytes(8, 2), bytes(0, 2)].concat());
    }
    let first = file.len();
    file.extend(bytes(0, word));
    // Data and lists of a page come first, then its directory; the pages below come before those that name them.
    let write = |file: &mut Vec<u8>, page: &Tiff, below: &[u64]| {
        let chunks = page.chunks();
        let place = |file: &mut Vec<u8>, data: &[u8]| {
            file.extend(data);
            (file.len() - data.len()) as u64
        };
        let offsets: Vec<u64> = chunks.iter().map(|chunk| place(file, chunk)).collect();
        let lengths: Vec<u64> = chunks.iter().map(|chunk| chunk.len() as u64).collect();
        let samples = page.colors + page.extra;
        let (offsets_tag, lengths_tag) = if page.tile > 0 { (324, 325) } else { (273, 279) };
        let mut entries: Vec<(u64, u64, Vec<u64>)> = vec![
            (254, 4, vec![page.subfile]),
            (256, 4, vec![page.width as u64]),
            (257, 4, vec![page.height as u64]),
            (258, 3, vec![page.bits as u64; samples]),
            (259, 3, vec![page.compression]),
            (262, 3, vec![page.photometric]),
            (277, 3, vec![samples as u64]),
            (284, 3, vec![if page.planar { 2 } else { 1 }]),
            (317, 3, vec![page.predictor]),
            (339, 3, vec![if page.float { 3 } else { 1 }; samples]),
            (offsets_tag, 4, offsets),
            (lengths_tag, 4, lengths),
        ];
        if page.tile > 0 {
            entries.extend([(322, 3, vec![page.tile as u64]), (323, 3, vec![page.tile as u64])]);
        } else {
            entries.push((278, 4, vec![page.rows.min(page.height) as u64]));
        }
        if page.extra > 0 {
            let mut kinds = vec![0; page.extra];
            kinds[0] = page.extra_kind;
            entries.push((338, 3, kinds));
        }
        if !page.profile.is_empty() {
            entries.push((34675, 7, page.profile.iter().map(|&byte| byte.into()).collect()));
        }
        if !below.is_empty() {
            entries.push((330, 13, below.to_vec()));
        }
        entries.sort_by_key(|entry| entry.0);
        let mut directory = bytes(entries.len() as u64, if head.big_tiff { 8 } else { 2 });
        for (tag, kind, values) in entries {
            let size = match kind {
                3 => 2,
                7 => 1,
                _ => 4,
            };
            let data: Vec<u8> = values.iter().flat_map(|&value| bytes(value, size)).collect();
            let mut field = if data.len() <= word { data } else { bytes(place(file, &data), word) };
            field.resize(word, 0);
            directory.extend([bytes(tag, 2), bytes(kind, 2), bytes(values.len() as u64, word), field].concat());
        }
        let start = place(file, &directory);
        let next = file.len();
        file.extend(bytes(0, word));
        (start, next)
    };
    let below: Vec<u64> = below.iter().map(|page| write(&mut file, page, &[]).0).collect();
    let mut link = first;
    for (i, page) in chain.iter().enumerate() {
        let (start, next) = write(&mut file, page, if i == 0 { &below } else { &[] });
        file[link..link + word].copy_from_slice(&bytes(start, word));
        link = next;
    }
    file
}

/// An uncompressed OpenEXR file of float channels (sorted by name, as the format wants): `data` and `display` are
/// (x, y, width, height); every channel has the data window's samples.
pub fn exr(data: [i32; 4], display: [i32; 4], channels: &[(&str, &[f32])]) -> Vec<u8> {
    exr_with(data, display, channels, None)
}

/// [`exr`] that states chromaticities: x and y of red, green, blue and white.
pub fn exr_with(
    data: [i32; 4],
    display: [i32; 4],
    channels: &[(&str, &[f32])],
    chromaticities: Option<[f32; 8]>,
) -> Vec<u8> {
    let mut file = vec![0x76, 0x2f, 0x31, 0x01, 2, 0, 0, 0];
    let mut attribute = |name: &str, kind: &str, value: &[u8]| {
        for text in [name, kind] {
            file.extend(text.bytes());
            file.push(0);
        }
        file.extend((value.len() as u32).to_le_bytes());
        file.extend(value);
    };
    let mut list = Vec::new();
    for (name, samples) in channels {
        assert_eq!(samples.len() as i32, data[2] * data[3]);
        list.extend(name.bytes());
        list.push(0);
        for value in [2u32, 0, 1, 1] {
            list.extend(value.to_le_bytes());
        }
    }
    list.push(0);
    let window = |[x, y, width, height]: [i32; 4]| [x, y, x + width - 1, y + height - 1].map(i32::to_le_bytes).concat();
    attribute("channels", "chlist", &list);
    if let Some(chromaticities) = chromaticities {
        attribute("chromaticities", "chromaticities", &chromaticities.map(f32::to_le_bytes).concat());
    }
    attribute("compression", "compression", &[0]);
    attribute("dataWindow", "box2i", &window(data));
    attribute("displayWindow", "box2i", &window(display));
    attribute("lineOrder", "lineOrder", &[0]);
    attribute("pixelAspectRatio", "float", &1.0f32.to_le_bytes());
    attribute("screenWindowCenter", "v2f", &[0; 8]);
    attribute("screenWindowWidth", "float", &1.0f32.to_le_bytes());
    file.push(0);
    let (width, height) = (data[2] as usize, data[3] as usize);
    let row_bytes = width * channels.len() * 4;
    let first = file.len() + 8 * height;
    for row in 0..height {
        file.extend(((first + row * (8 + row_bytes)) as u64).to_le_bytes());
    }
    for row in 0..height {
        file.extend((data[1] + row as i32).to_le_bytes());
        file.extend((row_bytes as u32).to_le_bytes());
        for (_, samples) in channels {
            file.extend(samples[row * width..(row + 1) * width].iter().flat_map(|v| v.to_le_bytes()));
        }
    }
    file
}

/// The chunk that holds an ICC profile in a PNG.
pub fn iccp(profile: &[u8]) -> (&'static [u8; 4], Vec<u8>) {
    let mut encoder = flate2::write::ZlibEncoder::new(b"profile\0\0".to_vec(), flate2::Compression::fast());
    std::io::Write::write_all(&mut encoder, profile).unwrap();
    (b"iCCP", encoder.finish().unwrap())
}

/// A JPEG file with a segment put behind its first marker.
pub fn jpeg_with(file: &[u8], marker: u8, segment: &[u8]) -> Vec<u8> {
    let mut out = vec![0xff, 0xd8, 0xff, marker];
    out.extend((segment.len() as u16 + 2).to_be_bytes());
    out.extend(segment);
    out.extend(&file[2..]);
    out
}

/// EXIF data as a JPEG's segment holds them: a directory with the EXIF one, then `directories`, each entry a tag, its type, how many values, and the value.
pub fn exif(directories: &[&[(u16, u16, u32, u32)]]) -> Vec<u8> {
    let mut out = b"Exif\0\0II\x2a\0\x08\0\0\0".to_vec();
    for entries in [&[&[(0x8769, 4, 1, 26)][..]], directories].concat() {
        out.extend((entries.len() as u16).to_le_bytes());
        for (tag, kind, count, value) in entries {
            out.extend([tag.to_le_bytes(), kind.to_le_bytes()].concat());
            out.extend([count.to_le_bytes(), value.to_le_bytes()].concat());
        }
        out.extend([0; 4]);
    }
    out
}

/// An ICC profile whose only tag is a table: linear values in the primaries of sRGB, with 2 x 2 x 2 entries.
pub fn table_profile() -> Vec<u8> {
    let mut table = b"mft2\0\0\0\0\x03\x03\x02\0".to_vec();
    for i in 0..9 {
        table.extend(if i % 4 == 0 { 65536u32 } else { 0 }.to_be_bytes());
    }
    table.extend([0, 2, 0, 2]);
    let linear = [0u16, 65535].map(u16::to_be_bytes).concat().repeat(3);
    table.extend(&linear);
    // X, Y and Z of the primaries: IEC 61966-2-1 relative to D50; 1 is stored as 32768.
    let axes = [[0.4361, 0.3851, 0.1431], [0.2225, 0.7169, 0.0606], [0.0139, 0.0971, 0.7141]];
    for corner in 0..8 {
        for axis in axes {
            let sum: f64 = (0..3).map(|c| f64::from(corner >> (2 - c) & 1) * axis[c]).sum();
            table.extend(((sum * 32768.0).round() as u16).to_be_bytes());
        }
    }
    table.extend(&linear);
    let mut profile = vec![0; 128];
    profile[8..12].copy_from_slice(&[2, 0x40, 0, 0]);
    profile[12..24].copy_from_slice(b"scnrRGB XYZ ");
    profile[36..40].copy_from_slice(b"acsp");
    profile[68..80].copy_from_slice(&[0, 0, 0xf6, 0xd6, 0, 1, 0, 0, 0, 0, 0xd3, 0x2d]);
    profile.extend(1u32.to_be_bytes());
    profile.extend(b"A2B0");
    profile.extend(144u32.to_be_bytes());
    profile.extend((table.len() as u32).to_be_bytes());
    profile.extend(table);
    let length = profile.len() as u32;
    profile[..4].copy_from_slice(&length.to_be_bytes());
    profile
}
