//! Image files written byte by byte, so that the readers are not tested against the encoders of their own crates.

/// A PNG of 8- or 16-bit samples (each `u16` is one sample), uncompressed. `kind`: 0 grey, 2 RGB, 4 grey and alpha, 6 RGB and alpha.
pub fn png(width: u32, height: u32, kind: u8, depth: u8, samples: &[u16]) -> Vec<u8> {
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
    for (name, data) in [(b"IHDR", header), (b"IDAT", zlib), (b"IEND", Vec::new())] {
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

/// How [`tiff_lzw`] lays a file out.
#[derive(Clone, Copy, Debug)]
pub struct LzwLayout {
    /// Bytes of a number from the highest to the lowest.
    pub big_endian: bool,
    /// The form for files above 4 GiB.
    pub big_tiff: bool,
    /// Tiles of 16 x 16 instead of one strip.
    pub tiles: bool,
    /// The closing code of every stream.
    pub closed: bool,
}

pub const LZW_LAYOUTS: [LzwLayout; 5] = {
    let plain = LzwLayout { big_endian: false, big_tiff: false, tiles: false, closed: true };
    [
        plain,
        LzwLayout { tiles: true, ..plain },
        LzwLayout { tiles: true, closed: false, ..plain },
        LzwLayout { tiles: true, big_endian: true, ..plain },
        LzwLayout { big_endian: true, big_tiff: true, ..plain },
    ]
};

/// An LZW-compressed TIFF of 16-bit RGB codes. Of a strip more or fewer `values` than pixels may be given.
pub fn tiff_lzw(width: usize, height: usize, values: &[u16], layout: LzwLayout) -> Vec<u8> {
    let LzwLayout { big_endian, big_tiff, tiles, closed } = layout;
    let bytes = |value: u64, count: usize| {
        if big_endian { value.to_be_bytes()[8 - count..].to_vec() } else { value.to_le_bytes()[..count].to_vec() }
    };
    let packed = |values: &[u16]| {
        let data: Vec<u8> = values.iter().flat_map(|&value| bytes(value.into(), 2)).collect();
        let mut encoder = weezl::encode::Encoder::with_tiff_size_switch(weezl::BitOrder::Msb, 8);
        if closed {
            return encoder.encode(&data).unwrap();
        }
        let mut out = vec![0; 2 * data.len() + 64];
        let written = encoder.encode_bytes(&data, &mut out).consumed_out;
        // What is left in the encoder are a code or two: they are written with the closing code, which is cut off.
        encoder.finish();
        let rest = encoder.encode_bytes(&[], &mut out[written..]).consumed_out;
        out.truncate(written + rest - 1);
        out
    };
    let chunks: Vec<Vec<u8>> = if tiles {
        let value =
            |x: usize, y: usize, c: usize| if x < width && y < height { values[(y * width + x) * 3 + c] } else { 0 };
        let tile = |left: usize, top: usize| {
            let pixels = (0..16).flat_map(|y| (0..16).map(move |x| (left + x, top + y)));
            let tile: Vec<u16> = pixels.flat_map(|(x, y)| (0..3).map(move |c| value(x, y, c))).collect();
            packed(&tile)
        };
        (0..height.div_ceil(16))
            .flat_map(|y| (0..width.div_ceil(16)).map(move |x| (16 * x, 16 * y)))
            .map(|(x, y)| tile(x, y))
            .collect()
    } else {
        vec![packed(values)]
    };

    let word = if big_tiff { 8 } else { 4 };
    let mut file = if big_endian { b"MM".to_vec() } else { b"II".to_vec() };
    file.extend(bytes(if big_tiff { 43 } else { 42 }, 2));
    if big_tiff {
        file.extend([bytes(8, 2), bytes(0, 2)].concat());
    }
    // Streams and lists come first, then the directory.
    let mut body: Vec<u8> = Vec::new();
    let start = file.len() + word;
    let mut place = |data: &[u8]| {
        body.extend(data);
        (start + body.len() - data.len()) as u64
    };
    let offsets: Vec<u64> = chunks.iter().map(|chunk| place(chunk)).collect();
    let mut list = |values: &[u64], size: usize| {
        let data: Vec<u8> = values.iter().flat_map(|&value| bytes(value, size)).collect();
        let inline = data.len() <= word;
        let mut field = if inline { data } else { bytes(place(&data), word) };
        field.resize(word, 0);
        field
    };
    let lengths: Vec<u64> = chunks.iter().map(|chunk| chunk.len() as u64).collect();
    let (offsets, lengths) = (list(&offsets, 4), list(&lengths, 4));
    let bits = list(&[16, 16, 16], 2);
    let one = |value: usize, size: usize| {
        let mut field = bytes(value as u64, size);
        field.resize(word, 0);
        field
    };
    let mut entries = vec![
        (256u64, 4u64, 1, one(width, 4)),
        (257, 4, 1, one(height, 4)),
        (258, 3, 3, bits),
        (259, 3, 1, one(5, 2)),
        (262, 3, 1, one(2, 2)),
        (277, 3, 1, one(3, 2)),
    ];
    let count = chunks.len() as u64;
    if tiles {
        entries.extend([
            (322, 3, 1, one(16, 2)),
            (323, 3, 1, one(16, 2)),
            (324, 4, count, offsets),
            (325, 4, count, lengths),
        ]);
    } else {
        entries.extend([(273, 4, 1, offsets), (278, 4, 1, one(height, 4)), (279, 4, 1, lengths)]);
        entries.sort_by_key(|entry| entry.0);
    }
    file.extend(bytes((start + body.len()) as u64, word));
    file.extend(body);
    file.extend(bytes(entries.len() as u64, if big_tiff { 8 } else { 2 }));
    for (tag, kind, count, value) in entries {
        file.extend([bytes(tag, 2), bytes(kind, 2), bytes(count, word), value].concat());
    }
    file.extend(bytes(0, word));
    file
}

/// An uncompressed OpenEXR file of float channels (sorted by name, as the format wants): `data` and `display` are
/// (x, y, width, height); every channel has the data window's samples.
pub fn exr(data: [i32; 4], display: [i32; 4], channels: &[(&str, &[f32])]) -> Vec<u8> {
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
