//! Whether the data of a JPEG file hold its whole picture.
//!
//! Decoders make a picture of whatever they get: what is missing becomes grey or repeats what came before, and damaged codes become other
//! blocks. Nothing in the format protects the pixels, but the codes of a scan must be valid, make exactly its blocks and end
//! where the next marker is. That is what is checked here: the codes are read, the pixels are left to the decoder.
//!
//! # Source
//! ITU-T T.81, annexes B (markers), C (code tables), F (sequential) and G (progressive).

use std::path::Path;
use std::result::Result;

use super::decode::{broken, unsupported};
use crate::cancel::CancelToken;

/// Scans beyond this many are no photo; the decoder has the same limit.
const MAX_SCANS: usize = 100;

/// A component of the picture.
struct Component {
    id: u8,
    horizontal: usize,
    vertical: usize,
    /// Blocks of the picture, and with those that fill the last units up.
    width: usize,
    height: usize,
    padded_width: usize,
    /// Progressive: which coefficients of every block are known not to be 0.
    nonzero: Vec<u64>,
    /// The lowest bit that scans have brought of every coefficient; none before the first.
    precision: [Option<u8>; 64],
}

struct Frame {
    progressive: bool,
    components: Vec<Component>,
    /// Units of interleaved scans.
    units_across: usize,
    units_down: usize,
}

/// A Huffman code. Codes stand at the upper end of 16 bits, in which longer ones are above shorter ones.
struct Table {
    /// By the first 8 bits: length and symbol of a code of at most 8 bits; length 0 where there is none.
    short: [(u8, u8); 256],
    /// Where the codes of each length end.
    ends: [u32; 17],
    /// What is added to a code of each length for the index of its symbol.
    firsts: [i32; 17],
    symbols: Vec<u8>,
}

/// What a scan's header says, but for its components.
struct Spectrum {
    start: usize,
    end: usize,
    /// Bits of the coefficients below those that an earlier scan brought; 0 for a first scan.
    high: u8,
    low: u8,
}

/// Checks the codes of `bytes`, a JPEG file, and returns what a user should know of: bytes left over, or scans that never came.
///
/// Kinds of JPEG that the decoder refuses by itself are left to it.
///
/// # Errors
/// [`Error::Io`](crate::Error::Io) if part of the picture is missing or damaged,
/// [`Error::UnsupportedFormat`](crate::Error::UnsupportedFormat) for CMYK, whose colours only a profile of inks knows.
pub(super) fn check(path: &Path, bytes: &[u8], cancel: &CancelToken) -> crate::Result<Option<String>> {
    let reader = Reader { bytes, cancel, at: 2, dc: Default::default(), ac: Default::default(), restart_interval: 0 };
    let checked = reader.run().map_err(|reason| broken(path, reason))?;
    if checked.components == 4 {
        return Err(unsupported(path, "a JPEG of 4 components (CMYK); read are grey and colour: save it as RGB"));
    }
    Ok(checked.note)
}

#[derive(Default)]
struct Checked {
    components: usize,
    note: Option<String>,
}

struct Reader<'a> {
    bytes: &'a [u8],
    cancel: &'a CancelToken,
    at: usize,
    dc: [Option<Table>; 4],
    ac: [Option<Table>; 4],
    restart_interval: usize,
}

impl Reader<'_> {
    fn run(mut self) -> Result<Checked, String> {
        let bytes = self.bytes;
        let mut frame: Option<Frame> = None;
        let mut scans = 0;
        let mut left_over = 0;
        loop {
            let marker = self.marker().ok_or("JPEG without its end marker: truncated")?;
            match marker {
                0xd9 => break,
                0x01 | 0xd0..=0xd8 => continue,
                _ => {}
            }
            let length = bytes.get(self.at..self.at + 2).map_or(0, |b| usize::from(b[0]) << 8 | usize::from(b[1]));
            let segment = bytes.get(self.at + 2..self.at + length.max(2));
            let segment = segment.ok_or("JPEG cut within a header: truncated")?;
            self.at += length.max(2);
            match marker {
                0xc4 => self.tables(segment)?,
                0xdd => {
                    self.restart_interval = segment.get(..2).map_or(0, |b| usize::from(b[0]) << 8 | usize::from(b[1]))
                }
                // More bits than 8, which the decoder refuses.
                0xc0..=0xc2 if segment.first() != Some(&8) => return Ok(Checked::default()),
                0xc0..=0xc2 => match Frame::new(segment, marker == 0xc2) {
                    Some(new) if frame.is_none() => frame = Some(new),
                    _ => return Err("JPEG frame header damaged".to_owned()),
                },
                // Lossless, hierarchical and arithmetic coding.
                0xc3 | 0xc5..=0xc7 | 0xc9..=0xcf => return Ok(Checked::default()),
                0xda => {
                    scans += 1;
                    let frame = frame.as_mut().ok_or("JPEG scan before its frame header: damaged")?;
                    if scans > MAX_SCANS {
                        return Err(format!("JPEG of more than {MAX_SCANS} scans"));
                    }
                    left_over += self.scan(frame, segment)?;
                }
                _ => {}
            }
        }
        let frame = frame.ok_or("JPEG without a picture")?;
        if let Some(missing) = frame.components.iter().find(|component| component.precision[0].is_none()) {
            return Err(format!("JPEG that ends before component {} of its picture: truncated", missing.id));
        }
        let coarse = frame.components.iter().flat_map(|component| component.precision).any(|bits| bits != Some(0));
        let note = if frame.progressive && coarse {
            Some("the JPEG ends before its finest scans: it may be truncated".to_owned())
        } else if left_over > 0 {
            Some(format!("{left_over} bytes of the JPEG's data are not part of its picture: it may be damaged"))
        } else {
            None
        };
        Ok(Checked { components: frame.components.len(), note })
    }

    /// The next marker, behind it.
    fn marker(&mut self) -> Option<u8> {
        loop {
            let (&byte, &next) = (self.bytes.get(self.at)?, self.bytes.get(self.at + 1)?);
            self.at += 1;
            if byte == 0xff && !matches!(next, 0 | 0xff) {
                self.at += 1;
                return Some(next);
            }
        }
    }

    fn tables(&mut self, mut segment: &[u8]) -> Result<(), String> {
        let damaged = || "JPEG code table damaged".to_owned();
        while let Some((&place, rest)) = segment.split_first() {
            let (counts, rest) = rest.split_at_checked(16).ok_or_else(damaged)?;
            let symbols = counts.iter().map(|&count| usize::from(count)).sum();
            let (symbols, rest) = rest.split_at_checked(symbols).ok_or_else(damaged)?;
            let table = Table::new(counts, symbols).ok_or_else(damaged)?;
            let tables = if place >> 4 == 0 { &mut self.dc } else { &mut self.ac };
            *tables.get_mut(usize::from(place & 15)).ok_or_else(damaged)? = Some(table);
            segment = rest;
        }
        Ok(())
    }

    /// Reads the codes of the scan that begins here, up to the marker behind them; returns how many bytes are left over before it.
    fn scan(&mut self, frame: &mut Frame, header: &[u8]) -> Result<usize, String> {
        let damaged = || "JPEG scan header damaged".to_owned();
        let (&count, rest) = header.split_first().ok_or_else(damaged)?;
        let (list, rest) = rest.split_at_checked(2 * usize::from(count)).ok_or_else(damaged)?;
        let &[start, end, bits] = rest.get(..3).and_then(|rest| rest.try_into().ok()).ok_or_else(damaged)?;
        let spectrum = if frame.progressive {
            Spectrum { start: start.into(), end: end.into(), high: bits >> 4, low: bits & 15 }
        } else {
            Spectrum { start: 0, end: 63, high: 0, low: 0 }
        };
        let mut places = Vec::new();
        for pair in list.chunks_exact(2) {
            let index = frame.components.iter().position(|component| component.id == pair[0]).ok_or_else(damaged)?;
            places.push((index, usize::from(pair[1] >> 4), usize::from(pair[1] & 15)));
        }
        let dc_only = spectrum.start == 0 && spectrum.end == 0;
        let ac_only = spectrum.start > 0 && places.len() == 1;
        if places.is_empty() || spectrum.end > 63 || spectrum.start > spectrum.end || spectrum.low > 13 {
            return Err(damaged());
        }
        if frame.progressive && !dc_only && !ac_only {
            return Err(damaged());
        }
        for &(index, ..) in &places {
            let component = &mut frame.components[index];
            component.precision[spectrum.start..=spectrum.end].fill(Some(spectrum.low));
            if ac_only && component.nonzero.is_empty() {
                let blocks = component.padded_width * frame.units_down * component.vertical;
                component.nonzero.try_reserve_exact(blocks).map_err(|e| e.to_string())?;
                component.nonzero.resize(blocks, 0);
            }
        }

        let single = places.len() == 1;
        let (across, down) = if single {
            let component = &frame.components[places[0].0];
            (component.width, component.height)
        } else {
            (frame.units_across, frame.units_down)
        };
        let mut codes = Codes { bytes: self.bytes, at: self.at, buffer: 0, count: 0 };
        let (mut end_of_band, mut left_over) = (0, 0);
        let total = across * down;
        for unit in 0..total {
            if self.restart_interval > 0 && unit > 0 && unit % self.restart_interval == 0 {
                left_over += codes.left_over();
                codes.restart((unit / self.restart_interval - 1) % 8)?;
                end_of_band = 0;
            }
            let (column, row) = (unit % across, unit / across);
            if column == 0 && self.cancel.is_cancelled() {
                return Err("cancelled".to_owned());
            }
            for &(index, dc, ac) in &places {
                let component = &mut frame.components[index];
                let (blocks_across, blocks_down) =
                    if single { (1, 1) } else { (component.horizontal, component.vertical) };
                for block in 0..blocks_across * blocks_down {
                    let x = column * blocks_across + block % blocks_across;
                    let y = row * blocks_down + block / blocks_across;
                    let place = y * component.padded_width + x;
                    let result = if !frame.progressive {
                        self.sequential(&mut codes, dc, ac)
                    } else if dc_only {
                        self.direct_current(&mut codes, dc, &spectrum)
                    } else {
                        let nonzero = &mut component.nonzero[place];
                        self.band(&mut codes, ac, &spectrum, nonzero, &mut end_of_band)
                    };
                    let part = || format!("row {} of {down} of the picture's blocks", row + 1);
                    result.map_err(|reason| format!("JPEG {reason} in {}: truncated or damaged", part()))?;
                }
            }
        }
        left_over += codes.left_over();
        self.at = codes.at;
        Ok(left_over)
    }

    fn sequential(&self, codes: &mut Codes<'_>, dc: usize, ac: usize) -> Result<(), &'static str> {
        let (dc, ac) = (self.dc_table(dc)?, self.ac_table(ac)?);
        codes.skip_dc_difference(dc)?;
        let mut k = 1;
        while k < 64 {
            let symbol = codes.symbol(ac)?;
            match (usize::from(symbol >> 4), symbol & 15) {
                (15, 0) => k += 16,
                (_, 0) => return Ok(()),
                (run, bits) => {
                    k += run + 1;
                    codes.bits(bits)?;
                }
            }
        }
        if k > 64 { Err("block with too many coefficients") } else { Ok(()) }
    }

    fn direct_current(&self, codes: &mut Codes<'_>, dc: usize, spectrum: &Spectrum) -> Result<(), &'static str> {
        if spectrum.high > 0 {
            return codes.bits(1).map(drop);
        }
        codes.skip_dc_difference(self.dc_table(dc)?)
    }

    /// The coefficients of one block in a progressive scan; `nonzero` has a bit for each.
    fn band(
        &self,
        codes: &mut Codes<'_>,
        ac: usize,
        spectrum: &Spectrum,
        nonzero: &mut u64,
        end_of_band: &mut u32,
    ) -> Result<(), &'static str> {
        let refines = spectrum.high > 0;
        let mut k = spectrum.start;
        while k <= spectrum.end && *end_of_band == 0 {
            let symbol = codes.symbol(self.ac_table(ac)?)?;
            let (mut run, bits) = (usize::from(symbol >> 4), symbol & 15);
            if bits == 0 && run < 15 {
                *end_of_band = (1 << run) + codes.bits(run as u8)?;
                break;
            }
            if refines && bits > 1 {
                return Err("invalid code");
            }
            codes.bits(bits)?;
            if !refines {
                k += run;
            }
            // A refining scan passes over coefficients that are not 0, each with a bit of its own, and counts only the others.
            while refines && k <= spectrum.end {
                if *nonzero >> k & 1 == 1 {
                    codes.bits(1)?;
                } else if run == 0 {
                    break;
                } else {
                    run -= 1;
                }
                k += 1;
            }
            if bits > 0 {
                if k > spectrum.end {
                    return Err("block with too many coefficients");
                }
                *nonzero |= 1 << k;
            }
            k += 1;
        }
        if *end_of_band > 0 {
            if refines && k <= spectrum.end {
                let rest = *nonzero >> k & (u64::MAX >> (63 - (spectrum.end - k)));
                for _ in 0..rest.count_ones() {
                    codes.bits(1)?;
                }
            }
            *end_of_band -= 1;
        }
        Ok(())
    }

    fn dc_table(&self, index: usize) -> Result<&Table, &'static str> {
        self.dc.get(index).and_then(Option::as_ref).ok_or("code table missing")
    }

    fn ac_table(&self, index: usize) -> Result<&Table, &'static str> {
        self.ac.get(index).and_then(Option::as_ref).ok_or("code table missing")
    }
}

impl Frame {
    /// None where the header is damaged.
    fn new(segment: &[u8], progressive: bool) -> Option<Self> {
        let word = |at: usize| Some(usize::from(*segment.get(at)?) << 8 | usize::from(*segment.get(at + 1)?));
        let (height, width, count) = (word(1)?, word(3)?, usize::from(*segment.get(5)?));
        let list: Vec<_> = segment.get(6..6 + 3 * count)?.chunks_exact(3).collect();
        let factors = |entry: &&[u8]| (usize::from(entry[1] >> 4), usize::from(entry[1] & 15));
        let (across, down) = (list.iter().map(|e| factors(e).0).max()?, list.iter().map(|e| factors(e).1).max()?);
        if width == 0
            || height == 0
            || list.iter().any(|e| !(1..=4).contains(&factors(e).0) || !(1..=4).contains(&factors(e).1))
        {
            return None;
        }
        let (units_across, units_down) = (width.div_ceil(8 * across), height.div_ceil(8 * down));
        let component = |entry: &&[u8]| {
            let (horizontal, vertical) = factors(entry);
            Component {
                id: entry[0],
                horizontal,
                vertical,
                width: (width * horizontal).div_ceil(8 * across),
                height: (height * vertical).div_ceil(8 * down),
                padded_width: units_across * horizontal,
                nonzero: Vec::new(),
                precision: [None; 64],
            }
        };
        Some(Self { progressive, components: list.iter().map(component).collect(), units_across, units_down })
    }
}

impl Table {
    /// None where there are more codes than their lengths allow.
    fn new(counts: &[u8], symbols: &[u8]) -> Option<Self> {
        let mut table = Self { short: [(0, 0); 256], ends: [0; 17], firsts: [0; 17], symbols: symbols.to_vec() };
        let (mut code, mut index) = (0u32, 0);
        for (length, &count) in (1..=16).zip(counts) {
            table.firsts[length] = index as i32 - (code >> (16 - length)) as i32;
            for _ in 0..count {
                let next = code + (1 << (16 - length));
                if next > 1 << 16 {
                    return None;
                }
                if length <= 8 {
                    table.short[code as usize >> 8..next as usize >> 8].fill((length as u8, symbols[index]));
                }
                (code, index) = (next, index + 1);
            }
            table.ends[length] = code;
        }
        Some(table)
    }

    /// The length of the code that the 16 bits `next` begin with, and its symbol; length 0 where there is none.
    fn find(&self, next: u16) -> (u8, u8) {
        let short = self.short[usize::from(next >> 8)];
        if short.0 > 0 {
            return short;
        }
        match (9..=16).find(|&length| u32::from(next) < self.ends[length]) {
            Some(length) => {
                let index = self.firsts[length] + i32::from(next >> (16 - length));
                (length as u8, self.symbols[index as usize])
            }
            None => (0, 0),
        }
    }
}

/// The bits of a scan.
struct Codes<'a> {
    bytes: &'a [u8],
    /// The next byte that is not in `buffer`; the marker, once it is reached.
    at: usize,
    buffer: u64,
    count: u32,
}

impl Codes<'_> {
    fn fill(&mut self) {
        while self.count <= 48 {
            let byte = match (self.bytes.get(self.at), self.bytes.get(self.at + 1)) {
                (Some(0xff), Some(0)) => {
                    self.at += 2;
                    0xff
                }
                (Some(0xff), _) | (None, _) => return,
                (Some(&byte), _) => {
                    self.at += 1;
                    byte
                }
            };
            self.buffer = self.buffer << 8 | u64::from(byte);
            self.count += 8;
        }
    }

    fn bits(&mut self, wanted: u8) -> Result<u32, &'static str> {
        let wanted = u32::from(wanted);
        if self.count < wanted {
            self.fill();
            if self.count < wanted {
                return Err("data end");
            }
        }
        self.count -= wanted;
        Ok((self.buffer >> self.count) as u32 & ((1 << wanted) - 1))
    }

    fn symbol(&mut self, table: &Table) -> Result<u8, &'static str> {
        if self.count < 16 {
            self.fill();
        }
        let next = if self.count >= 16 { self.buffer >> (self.count - 16) } else { self.buffer << (16 - self.count) };
        match table.find(next as u16) {
            (0, _) if self.count < 16 => Err("data end"),
            (0, _) => Err("invalid code"),
            (length, _) if u32::from(length) > self.count => Err("data end"),
            (length, symbol) => {
                self.count -= u32::from(length);
                Ok(symbol)
            }
        }
    }

    /// A difference of 8-bit pictures has 11 bits at most.
    fn skip_dc_difference(&mut self, table: &Table) -> Result<(), &'static str> {
        match self.symbol(table)? {
            bits @ 0..=11 => self.bits(bits).map(drop),
            _ => Err("invalid code"),
        }
    }

    /// Bytes before the marker that were not needed. The last one may be filled up, with ones, or zeros as some programs do; one that
    /// holds something else counts.
    fn left_over(&mut self) -> usize {
        let fill = self.buffer & ((1 << (self.count % 8)) - 1);
        let filled = fill == 0 || fill == (1 << (self.count % 8)) - 1;
        let mut bytes = self.count as usize / 8 + usize::from(!filled);
        self.count = 0;
        while let Some(&byte) = self.bytes.get(self.at) {
            match (byte, self.bytes.get(self.at + 1)) {
                (0xff, Some(0)) => self.at += 2,
                (0xff, _) => break,
                _ => self.at += 1,
            }
            bytes += 1;
        }
        bytes
    }

    /// Passes the restart marker `number`.
    fn restart(&mut self, number: usize) -> Result<(), String> {
        while self.bytes.get(self.at..self.at + 2) == Some(&[0xff, 0xff]) {
            self.at += 1;
        }
        match self.bytes.get(self.at + 1) {
            Some(&marker) if marker == 0xd0 + number as u8 => {
                self.at += 2;
                Ok(())
            }
            got => Err(format!(
                "JPEG with marker {} where restart marker {number} belongs: truncated or damaged",
                got.map_or("none".to_owned(), |marker| format!("{marker:02x}"))
            )),
        }
    }
}
