//! Radiance RGBE pictures (`.hdr`): read one scanline at a time, so that memory does not grow with the picture; maps are written.
//!
//! G. Ward, "Real Pixels", Graphics Gems II (1991): four bytes per texel, three mantissas and a shared exponent. Scanlines
//! are flat, with old runs (a texel 1 1 1 n repeats the one before), or with new runs (each byte plane separately).

use std::io::{BufRead, Read};
use std::path::Path;

use crate::codec::file;
use crate::light::{EnvironmentMap, validate_map};
use crate::{Error, Result};
use glam::Vec3;

/// Most bytes of a header line that are read.
const LONGEST_LINE: u64 = 4096;
/// Most header lines before the size.
const MOST_LINES: usize = 256;

/// A picture whose header was read; the scanlines follow.
pub struct RadianceReader<R> {
    reader: R,
    /// Width and height in texels.
    pub size: [usize; 2],
    scanline: Vec<[u8; 4]>,
}

impl<R: BufRead> RadianceReader<R> {
    /// Reads the header.
    ///
    /// # Errors
    /// A clause that says what is wrong.
    pub fn new(mut reader: R) -> std::result::Result<Self, String> {
        let mut first = true;
        for _ in 0..MOST_LINES {
            let line = line(&mut reader)?;
            if first && !line.starts_with("#?") {
                return Err("it does not begin with #?".to_owned());
            }
            first = false;
            if line.starts_with("FORMAT=") && line != "FORMAT=32-bit_rle_rgbe" {
                return Err(format!("its format is {}", &line["FORMAT=".len()..]));
            }
            if line.is_empty() {
                let size = size(&self::line(&mut reader)?)?;
                return Ok(Self { reader, size, scanline: Vec::new() });
            }
        }
        Err("its header does not end".to_owned())
    }

    /// Reads the next scanline, from the top of the picture down, and passes its texels in order to `texel`.
    ///
    /// # Errors
    /// A clause that says what is wrong.
    pub fn scanline(&mut self, mut texel: impl FnMut(usize, Vec3)) -> std::result::Result<(), String> {
        let width = self.size[0];
        let start = self.quad()?;
        let run_length = usize::from(start[2]) << 8 | usize::from(start[3]);
        self.scanline.clear();
        if start[0] == 2 && start[1] == 2 && start[2] < 128 && run_length == width {
            self.scanline.resize(width, [0; 4]);
            (0..4).try_for_each(|plane| self.plane(plane))?;
        } else {
            self.flat(start)?;
        }
        self.scanline.iter().enumerate().for_each(|(x, &rgbe)| texel(x, decoded(rgbe)));
        Ok(())
    }

    fn quad(&mut self) -> std::result::Result<[u8; 4], String> {
        let mut bytes = [0; 4];
        self.reader.read_exact(&mut bytes).map_err(cut_short)?;
        Ok(bytes)
    }

    fn byte(&mut self) -> std::result::Result<u8, String> {
        let mut bytes = [0];
        self.reader.read_exact(&mut bytes).map_err(cut_short)?;
        Ok(bytes[0])
    }

    /// One byte of every texel: a count over 128 repeats the next byte, another copies as many.
    fn plane(&mut self, plane: usize) -> std::result::Result<(), String> {
        let (mut x, width) = (0, self.scanline.len());
        while x < width {
            let count = self.byte()?;
            let (length, repeated) = if count > 128 {
                (usize::from(count) - 128, Some(self.byte()?))
            } else {
                (usize::from(count), None)
            };
            if length == 0 || x + length > width {
                return Err("a run does not fit its scanline".to_owned());
            }
            for at in x..x + length {
                self.scanline[at][plane] = match repeated {
                    Some(value) => value,
                    None => self.byte()?,
                };
            }
            x += length;
        }
        Ok(())
    }

    /// Texels of four bytes, with the old runs.
    fn flat(&mut self, first: [u8; 4]) -> std::result::Result<(), String> {
        let (width, mut next, mut shift) = (self.size[0], first, 0);
        loop {
            match (next, self.scanline.last().copied()) {
                ([1, 1, 1, count], Some(last)) => {
                    let length = usize::from(count) << shift;
                    if shift > 16 || self.scanline.len() + length > width {
                        return Err("a run does not fit its scanline".to_owned());
                    }
                    self.scanline.resize(self.scanline.len() + length, last);
                    shift += 8;
                }
                _ => {
                    self.scanline.push(next);
                    shift = 0;
                }
            }
            if self.scanline.len() == width {
                return Ok(());
            }
            next = self.quad()?;
        }
    }
}

fn cut_short(error: std::io::Error) -> String {
    match error.kind() {
        std::io::ErrorKind::UnexpectedEof => "it is truncated".to_owned(),
        _ => error.to_string(),
    }
}

fn line(reader: &mut impl BufRead) -> std::result::Result<String, String> {
    let mut bytes = Vec::new();
    reader.take(LONGEST_LINE).read_until(b'\n', &mut bytes).map_err(cut_short)?;
    if bytes.pop() != Some(b'\n') {
        return Err("its header is truncated".to_owned());
    }
    Ok(String::from_utf8_lossy(&bytes).trim_end().to_owned())
}

fn size(line: &str) -> std::result::Result<[usize; 2], String> {
    let words: Vec<&str> = line.split_whitespace().collect();
    let sides = match words[..] {
        ["-Y", height, "+X", width] => width.parse().ok().zip(height.parse().ok()),
        _ => None,
    };
    match sides {
        Some((width, height)) => Ok([width, height]),
        None => Err(format!("its size is given as {line:?}, not as -Y height +X width")),
    }
}

/// Mantissas times 2^(exponent − 136).
fn decoded([r, g, b, exponent]: [u8; 4]) -> Vec3 {
    if exponent == 0 {
        return Vec3::ZERO;
    }
    Vec3::new(f32::from(r), f32::from(g), f32::from(b)) * (f32::from(exponent) - 136.0).exp2()
}

impl EnvironmentMap {
    /// Writes a Radiance HDR file, for programs that read no OpenEXR; `path` is created only when the file is complete.
    ///
    /// # Errors
    /// [`Error::Run`] for a map of another size than its texels, or with a radiance that is negative, not finite or above
    /// [`MAX_RADIANCE`](crate::light::MAX_RADIANCE); [`Error::Io`] if the file cannot be written.
    pub fn write_hdr(&self, path: &Path) -> Result<()> {
        let wrong = |problem: String| Error::run(format!("writing {}", path.display()), problem);
        let (width, height) = (self.width as usize, self.height as usize);
        if self.radiance.len() != width * height || self.radiance.is_empty() {
            return Err(wrong(format!("{} texels do not fill {width} × {height}", self.radiance.len())));
        }
        validate_map(self).map_err(wrong)?;
        let mut bytes =
            format!("#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y {height} +X {width}\n").into_bytes();
        for row in self.radiance.chunks_exact(width) {
            let texels: Vec<[u8; 4]> = row.iter().map(|texel| encoded(*texel)).collect();
            if (8..1 << 15).contains(&width) {
                bytes.extend([2, 2, (width >> 8) as u8, width as u8]);
                (0..4).for_each(|plane| push_plane(&mut bytes, texels.iter().map(|texel| texel[plane])));
            } else {
                bytes.extend(texels.as_flattened());
            }
        }
        file::write_bytes(path, &bytes)
    }
}

/// The nearest RGBE of a radiance; inverse of [`decoded`].
fn encoded(radiance: Vec3) -> [u8; 4] {
    let largest = f64::from(radiance.max_element());
    if largest < f64::from(f32::MIN_POSITIVE) {
        return [0; 4];
    }
    let mut exponent = largest.log2().floor() as i32 + 1;
    // Rounding may need a ninth bit.
    if (largest * f64::from(8 - exponent).exp2()).round() > 255.0 {
        exponent += 1;
    }
    let mantissa = |x: f32| (f64::from(x) * f64::from(8 - exponent).exp2()).round() as u8;
    let [r, g, b] = radiance.to_array().map(mantissa);
    [r, g, b, (exponent + 128).clamp(1, 255) as u8]
}

/// Appends a byte of every texel, with runs of three and more as runs.
fn push_plane(out: &mut Vec<u8>, plane: impl Iterator<Item = u8>) {
    let plane: Vec<u8> = plane.collect();
    let mut at = 0;
    while at < plane.len() {
        let run = plane[at..].iter().take(127).take_while(|byte| **byte == plane[at]).count();
        if run >= 3 {
            out.extend([128 + run as u8, plane[at]]);
            at += run;
            continue;
        }
        let alike = |at: usize| plane[at..].windows(3).next().is_some_and(|w| w[0] == w[1] && w[1] == w[2]);
        let length = (at..plane.len()).take(128).take_while(|at| !alike(*at)).count();
        out.push(length as u8);
        out.extend(&plane[at..at + length]);
        at += length;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_written_map_comes_back_within_eight_bits() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("map.hdr");
        for width in [6, 64, 300] {
            let mut map = EnvironmentMap::from_directions(width, width / 2, |d| {
                Vec3::new(d.x.max(0.0) * 1e3, (d.y * 9.0).exp(), 0.25 + d.z * d.z * 1e-3)
            });
            map.radiance[3] = Vec3::ZERO;
            map.radiance[5] = Vec3::new(0.9999, 0.1, 0.0);
            map.write_hdr(&path).unwrap();
            let back = EnvironmentMap::read(&path).unwrap();
            for (found, written) in back.radiance.iter().zip(&map.radiance) {
                let error = (*found - *written).abs().max_element();
                assert!(error <= written.max_element() / 255.0, "{found} {written}");
            }
        }
        let flat = EnvironmentMap::from_directions(512, 256, |_| Vec3::new(0.5, 0.25, 1.0));
        flat.write_hdr(&path).unwrap();
        assert_eq!(EnvironmentMap::read(&path).unwrap(), flat);
        assert!(std::fs::metadata(&path).unwrap().len() < 256 * 50, "runs are written as runs");
        let bad = EnvironmentMap::from_directions(8, 4, |_| Vec3::splat(-1.0));
        assert!(bad.write_hdr(&path).unwrap_err().to_string().contains("radiance"));
    }

    fn picture(size: &str, data: &[u8]) -> Vec<u8> {
        let mut bytes = format!("#?RADIANCE\n# a comment\nFORMAT=32-bit_rle_rgbe\n\n{size}\n").into_bytes();
        bytes.extend(data);
        bytes
    }

    fn texels(bytes: &[u8]) -> std::result::Result<Vec<Vec3>, String> {
        let mut reader = RadianceReader::new(bytes)?;
        let mut all = Vec::new();
        for _ in 0..reader.size[1] {
            reader.scanline(|_, value| all.push(value))?;
        }
        Ok(all)
    }

    #[test]
    fn all_three_kinds_of_scanline_are_read() {
        let one = [128, 64, 32, 129];
        let value = Vec3::new(1.0, 0.5, 0.25);
        let flat: Vec<u8> = [one, one, [0; 4]].concat();
        assert_eq!(texels(&picture("-Y 1 +X 3", &flat)).unwrap(), [value, value, Vec3::ZERO]);
        let old: Vec<u8> = [one, [1, 1, 1, 2], [0; 4]].concat();
        assert_eq!(texels(&picture("-Y 1 +X 4", &old)).unwrap(), [value, value, value, Vec3::ZERO]);
        let mut new = vec![2, 2, 0, 8];
        for byte in one {
            new.extend([128 + 6, byte, 2, byte, byte]);
        }
        assert_eq!(texels(&picture("-Y 1 +X 8", &new)).unwrap(), [value; 8]);
        for cut in 0..new.len() {
            assert!(texels(&picture("-Y 1 +X 8", &new[..cut])).unwrap_err().contains("truncated"));
        }
    }

    #[test]
    fn bad_headers_and_runs_are_refused() {
        let refused = |bytes: &[u8], word: &str| {
            let problem = texels(bytes).expect_err("a bad picture");
            assert!(problem.contains(word), "{problem} should say {word}");
        };
        refused(b"P6\n", "#?");
        refused(b"#?RADIANCE\nFORMAT=32-bit_rle_xyze\n\n-Y 1 +X 1\n", "xyze");
        refused(&picture("+X 3 -Y 1", &[]), "size");
        refused(&picture("-Y 1 +X 99999999999999999999", &[]), "size");
        refused(&picture("-Y 1 +X 8", &[2, 2, 0, 8, 137, 1]), "run");
        refused(&picture("-Y 1 +X 2", &[1, 2, 3, 4, 1, 1, 1, 9]), "run");
    }
}
