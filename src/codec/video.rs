//! H.264 video in MP4, made as its frames come: no other program is needed.
//!
//! | name | unit | value | meaning |
//! | --- | --- | --- | --- |
//! | [`QUANTIZER`] | | 18 | QP of H.264: about 47 dB to the frames |
//! | [`KEY_SECONDS`] | s | 2 | time between frames that a player can begin at |
//! | [`MOST_BYTES`] | B | 2³¹ | size of a film, which is in memory until it is written |
//!
//! The profile is Constrained Baseline, which every player has. Colors are BT.709 of limited range in 4:2:0, and the stream says so: players
//! take another matrix for small pictures that say nothing.

use crate::codec::file;
use crate::{Error, Result};
use image::RgbImage;
use muxide::api::{Metadata, Muxer, MuxerBuilder, VideoCodec};
use rusty_h264_common::YuvFrame;
use rusty_h264_encoder::{Encoder, EncoderConfig};
use std::io::Read as _;
use std::path::Path;

/// Quantization parameter of H.264, 0 to 51; six more are half the bits.
pub const QUANTIZER: u8 = 18;
/// Seconds between frames that a player can begin at.
pub const KEY_SECONDS: u32 = 2;
/// Most bytes of a video.
pub const MOST_BYTES: usize = 1 << 31;
/// How the title of every video begins, by which those are known that may be replaced.
pub const TITLE: &str = "Rendered by Lobelia";
/// Most bytes of the boxes of an MP4 that describe its frames.
const MOST_DESCRIBING: u64 = 1 << 26;
/// Bytes of a pixel of the encoder's pictures and maps, and of a pixel of each frame once it is compressed, written and copied.
const PIXEL_BYTES: u64 = 10;
const COMPRESSED_BYTES: f64 = 0.1;
/// Some values of `level_idc` of H.264, the macroblocks of a frame, and those of a second (ITU-T H.264, table A-1).
const LEVELS: [(u8, u64, u64); 9] = [
    (30, 1620, 40_500),
    (31, 3600, 108_000),
    (40, 8192, 245_760),
    (42, 8704, 522_240),
    (50, 22_080, 589_824),
    (51, 36_864, 983_040),
    (52, 36_864, 2_073_600),
    (60, 139_264, 4_177_920),
    (62, 139_264, 16_711_680),
];

/// A video that is being made. It is in memory, compressed, until it is written.
pub struct Video {
    encoder: Encoder,
    muxer: Muxer<Vec<u8>>,
    frame: YuvFrame,
    fps: u32,
    count: u32,
    bytes: usize,
}

impl std::fmt::Debug for Video {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Video").field("fps", &self.fps).field("count", &self.count).finish_non_exhaustive()
    }
}

impl Video {
    /// A video without frames, whose frames have this width and height in pixels; `fps` is in frames per second. An odd side is extended by
    /// its last line, as 4:2:0 needs. The title of the file is [`TITLE`], with the `comment`.
    ///
    /// # Errors
    /// [`Error::Run`] if H.264 has no level for frames of this size.
    pub fn new([width, height]: [u32; 2], fps: u32, comment: Option<&str>) -> Result<Self> {
        let failed = |problem: String| Error::run(format!("a video of {width} × {height} pixels"), problem);
        let [w, h] = [width, height].map(|side| side.next_multiple_of(2));
        let mut config = EncoderConfig::baseline(w as usize, h as usize);
        config.level_idc = level([w, h], fps).ok_or_else(|| failed("is more than H.264 has".into()))?;
        (config.qp, config.framerate) = (QUANTIZER, fps as f32);
        config.gop_size = KEY_SECONDS * fps;
        let encoder = Encoder::new(config).map_err(|error| failed(error.to_string()))?;
        let title = comment.map_or_else(|| TITLE.to_owned(), |comment| format!("{TITLE}: {comment}"));
        let muxer = MuxerBuilder::new(Vec::new()).with_metadata(Metadata::new().with_title(title));
        let muxer = muxer.video(VideoCodec::H264, w, h, f64::from(fps)).build();
        let muxer = muxer.map_err(|error| failed(error.to_string()))?;
        Ok(Self { encoder, muxer, frame: YuvFrame::black(w as usize, h as usize), fps, count: 0, bytes: 0 })
    }

    /// Appends a frame in sRGB.
    ///
    /// # Errors
    /// [`Error::Run`] if its size is not that of the video, or the video would have more than [`MOST_BYTES`].
    pub fn push(&mut self, frame: &RgbImage) -> Result<()> {
        let number = self.count;
        let failed = |problem: String| Error::run(format!("frame {number} of a video"), problem);
        let even = |side: u32| side.next_multiple_of(2) as usize;
        if [even(frame.width()), even(frame.height())] != [self.frame.width, self.frame.height] {
            return Err(failed(format!("it has {} × {} pixels", frame.width(), frame.height())));
        }
        set_bt709(&mut self.frame, frame);
        self.append()
    }

    /// Appends what is in `frame`.
    fn append(&mut self) -> Result<()> {
        let number = self.count;
        let failed = |problem: String| Error::run(format!("frame {number} of a video"), problem);
        let unit = self.encoder.try_encode(&self.frame).map_err(|error| failed(error.to_string()))?;
        let unit = with_color(&unit);
        self.bytes += unit.len();
        if self.bytes > MOST_BYTES {
            return Err(failed("it would have more than 2 GiB: choose fewer or smaller frames".into()));
        }
        let is_key = nal_units(&unit).any(|nal| nal_type(nal) == IDR);
        let seconds = f64::from(number) / f64::from(self.fps);
        self.muxer.write_video(seconds, &unit, is_key).map_err(|error| failed(error.to_string()))?;
        self.count += 1;
        Ok(())
    }

    /// Writes the MP4.
    ///
    /// # Errors
    /// [`Error::Run`] if it has no frame; [`Error::Io`] if the file cannot be written.
    pub fn write(mut self, path: &Path) -> Result<()> {
        let failed = |problem: String| Error::run(format!("writing {}", path.display()), problem);
        if self.count == 0 {
            return Err(failed("a video needs at least one frame".into()));
        }
        // The last frame lasts as long as the one before: a single one has to be there twice.
        if self.count == 1 {
            self.append()?;
        }
        self.muxer.finish_in_place().map_err(|error| failed(error.to_string()))?;
        let bytes = self.muxer.into_writer();
        file::write_bytes(path, &bytes)
    }
}

/// The title of an MP4 that [`Video`] wrote; `None` of any other file.
pub fn title_of(path: &Path) -> Option<String> {
    let mut file = file::open(path, |_| String::new()).ok()?;
    // The boxes of a file, one after the other, up to the one that describes it.
    loop {
        let mut head = [0; 8];
        file.read_exact(&mut head).ok()?;
        let length = u64::from(u32::from_be_bytes(head[..4].try_into().ok()?)).checked_sub(8)?;
        if head[4..] != *b"moov" {
            file.seek_relative(i64::try_from(length).ok()?).ok()?;
            continue;
        }
        let mut moov = Vec::new();
        file.take(length.min(MOST_DESCRIBING)).read_to_end(&mut moov).ok()?;
        let find = |text: &[u8]| moov.windows(text.len()).position(|bytes| bytes == text);
        // Programs that make another film of one, as ffmpeg, keep the title and add who they are.
        let at = find(TITLE.as_bytes()).filter(|_| find(b"\xa9too").is_none())?;
        // Before a text: the length of its box, its name, its type and its language.
        let length = u32::from_be_bytes(moov[at.checked_sub(16)?..at - 12].try_into().ok()?) as usize;
        return String::from_utf8(moov.get(at..at.checked_add(length.checked_sub(16)?)?)?.to_vec()).ok();
    }
}

/// Whether H.264 has frames of this width and height in pixels.
pub fn has_frames_of(size: [u32; 2]) -> bool {
    level(size, 1).is_some()
}

/// Peak memory in bytes of a video of so many frames of this width and height, about.
pub fn video_bytes([width, height]: [u32; 2], frames: u32) -> u64 {
    let pixels = u64::from(width) * u64::from(height);
    let compressed = (pixels as f64 * f64::from(frames) * COMPRESSED_BYTES) as u64;
    PIXEL_BYTES * pixels + compressed.min(3 * MOST_BYTES as u64)
}

/// The lowest of these levels of H.264 that has frames of this size at this rate; the highest one for more frames; `None` for larger ones, or longer
/// ones.
fn level([width, height]: [u32; 2], fps: u32) -> Option<u8> {
    let sides = [width, height].map(|side| u64::from(side.div_ceil(16)));
    let (blocks, longest) = (sides[0] * sides[1], sides[0].max(sides[1]));
    let fits = |most: u64| blocks <= most && longest * longest <= 8 * most;
    let mut fitting = LEVELS.iter().filter(|(_, most, _)| fits(*most));
    let slow_enough = fitting.clone().find(|(_, _, rate)| blocks * u64::from(fps) <= *rate);
    slow_enough.or_else(|| fitting.next_back()).map(|(level, ..)| *level)
}

/// Sets `out` to a picture in BT.709, limited range (ITU-R BT.709-6, item 3), with the mean color of four pixels. Beyond an odd side
/// its last line goes on.
fn set_bt709(out: &mut YuvFrame, rgb: &RgbImage) {
    let (width, height) = (rgb.width() as usize, rgb.height() as usize);
    let row_of = |y: usize| &rgb.as_raw()[3 * width * y.min(height - 1)..][..3 * width];
    let pixel = |row: &[u8], x: usize| [0, 1, 2].map(|c| i32::from(row[3 * x.min(width - 1) + c]));
    for (y, luma) in out.y.chunks_exact_mut(out.width).enumerate() {
        let row = row_of(y);
        for (x, luma) in luma.iter_mut().enumerate() {
            *luma = weighted(pixel(row, x), [11_966, 40_254, 4064], 16, 0);
        }
    }
    let chroma = out.u.chunks_exact_mut(out.width / 2).zip(out.v.chunks_exact_mut(out.width / 2));
    for (y, (blue, red)) in chroma.enumerate() {
        let rows = [row_of(2 * y), row_of(2 * y + 1)];
        for (x, (blue, red)) in blue.iter_mut().zip(red).enumerate() {
            let four = rows.map(|row| [pixel(row, 2 * x), pixel(row, 2 * x + 1)]);
            let sum = [0, 1, 2].map(|c| four.iter().flatten().map(|pixel| pixel[c]).sum());
            *blue = weighted(sum, [-6596, -22_189, 28_785], 128, 2);
            *red = weighted(sum, [28_785, -26_145, -2640], 128, 2);
        }
    }
}

/// Σ weight · color / 2^16 / 2^`halvings` + `offset`, rounded.
fn weighted(color: [i32; 3], weights: [i32; 3], offset: i32, halvings: i32) -> u8 {
    let sum: i32 = (0..3).map(|c| color[c] * weights[c]).sum();
    let bits = 16 + halvings;
    (offset + ((sum + (1 << (bits - 1))) >> bits)) as u8
}

/// `nal_unit_type` of a picture that can be begun at.
const IDR: u8 = 5;
/// `nal_unit_type` of a sequence parameter set.
const SEQUENCE: u8 = 7;

fn nal_type(nal: &[u8]) -> u8 {
    nal.first().map_or(0, |byte| byte & 31)
}

/// The units between the start codes of a byte stream (ITU-T H.264, annex B).
fn nal_units(stream: &[u8]) -> impl Iterator<Item = &[u8]> {
    let codes = stream.windows(3).enumerate().filter(|(_, bytes)| *bytes == [0, 0, 1]).map(|(at, _)| at);
    let ends = codes.clone().skip(1).chain([stream.len()]);
    codes.zip(ends).map(|(start, end)| {
        let unit = &stream[start + 3..end];
        let zeros = unit.iter().rev().take_while(|byte| **byte == 0).count();
        &unit[..unit.len() - zeros]
    })
}

/// The byte stream with BT.709 named in its sequence parameter sets.
fn with_color(stream: &[u8]) -> Vec<u8> {
    let mut out = Vec::with_capacity(stream.len() + 8);
    for nal in nal_units(stream) {
        out.extend_from_slice(&[0, 0, 0, 1]);
        if nal_type(nal) == SEQUENCE {
            out.extend(sequence_with_color(nal));
        } else {
            out.extend_from_slice(nal);
        }
    }
    out
}

/// A sequence parameter set with VUI parameters (ITU-T H.264, annex E) in place of the bit, its last, that says that there are none. No byte
/// of the VUI parameters needs to be escaped: no eight bits in a row of what names the colors are zero.
fn sequence_with_color(nal: &[u8]) -> Vec<u8> {
    let mut bits: Vec<bool> =
        nal.iter().flat_map(|byte| (0..8).rev().map(move |i| byte >> i & 1 > 0)).collect();
    let stop = bits.iter().rposition(|bit| *bit).unwrap_or(0);
    // The stop bit and the flag before it.
    if stop == 0 || bits[stop - 1] {
        return nal.to_vec();
    }
    bits.truncate(stop - 1);
    let mut put = |value: u32, count: u32| bits.extend((0..count).rev().map(|i| value >> i & 1 > 0));
    put(1, 1);
    // No aspect ratio, no overscan; a signal type: video format 5 (none), limited range, colors.
    put(0b0011_0101, 8);
    // Primaries, transfer and matrix of BT.709.
    (0..3).for_each(|_| put(1, 8));
    // No place of chroma, timing, two kinds of decoder parameters, structure of pictures, restriction; the stop bit.
    put(1, 7);
    let end = bits.len().next_multiple_of(8);
    bits.resize(end, false);
    bits.chunks_exact(8).map(|byte| byte.iter().fold(0, |byte, bit| byte << 1 | u8::from(*bit))).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::Rgb;
    use rusty_h264_decoder::Decoder;

    fn picture(i: u32, [width, height]: [u32; 2]) -> RgbImage {
        let wave = |x: u32, by: u32| (127.0 + 120.0 * ((x * by + 9 * i) as f32 / 40.0).sin()) as u8;
        RgbImage::from_fn(width, height, |x, y| Rgb([wave(x, 2), wave(y, 3), wave(x + y, 1)]))
    }

    /// Boxes of an MP4 by name, of which the named ones are opened.
    fn boxes(bytes: &[u8], found: &mut Vec<(String, Vec<u8>)>) {
        let mut rest = bytes;
        while rest.len() >= 8 {
            let length = u32::from_be_bytes(rest[..4].try_into().unwrap()) as usize;
            let name = String::from_utf8_lossy(&rest[4..8]).into_owned();
            let content = &rest[8..length];
            if ["moov", "trak", "mdia", "minf", "stbl"].contains(&name.as_str()) {
                boxes(content, found);
            }
            found.push((name, content.to_vec()));
            rest = &rest[length..];
        }
    }

    /// What a file says of its samples, and these as a byte stream.
    fn samples(path: &Path) -> (Vec<usize>, Vec<Vec<u8>>) {
        let mut found = Vec::new();
        boxes(&std::fs::read(path).unwrap(), &mut found);
        let content = |name: &str| found.iter().find(|(found, _)| found == name).unwrap().1.clone();
        let number =
            |bytes: &[u8], i: usize| u32::from_be_bytes(bytes[4 * i..4 * i + 4].try_into().unwrap()) as usize;
        let (sizes, mut data) = (content("stsz"), content("mdat"));
        let keys = content("stss");
        let keys = (0..number(&keys, 1)).map(|i| number(&keys, 2 + i)).collect();
        let streams = (0..number(&sizes, 2)).map(|i| {
            let rest = data.split_off(number(&sizes, 3 + i));
            let mut sample = std::mem::replace(&mut data, rest);
            let mut at = 0;
            while at < sample.len() {
                let length = number(&sample[at..], 0);
                sample[at..at + 4].copy_from_slice(&[0, 0, 0, 1]);
                at += 4 + length;
            }
            sample
        });
        let streams: Vec<Vec<u8>> = streams.collect();
        (keys, streams)
    }

    fn rgb_of(frame: &YuvFrame, x: usize, y: usize) -> [f32; 3] {
        let luma = (f32::from(frame.y[y * frame.width + x]) - 16.0) / 219.0;
        let at = y / 2 * (frame.width / 2) + x / 2;
        let [blue, red] = [&frame.u, &frame.v].map(|plane| (f32::from(plane[at]) - 128.0) / 224.0);
        let (r, b) = (luma + 1.5748 * red, luma + 1.8556 * blue);
        [r, (luma - 0.2126 * r - 0.0722 * b) / 0.7152, b].map(|x| 255.0 * x)
    }

    fn mean_error(frame: &YuvFrame, picture: &RgbImage) -> f32 {
        let each = picture.enumerate_pixels().map(|(x, y, pixel)| {
            let rgb = rgb_of(frame, x as usize, y as usize);
            (0..3).map(|c| (rgb[c] - f32::from(pixel[c])).abs()).sum::<f32>() / 3.0
        });
        each.sum::<f32>() / (picture.width() * picture.height()) as f32
    }

    #[test]
    fn frames_come_back_from_the_file() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("orbit.mp4");
        // Odd sides, no multiple of a macroblock.
        let size = [61, 35];
        let mut video = Video::new(size, 2, None).unwrap();
        (0..6).for_each(|i| video.push(&picture(i, size)).unwrap());
        video.write(&path).unwrap();
        let (keys, streams) = samples(&path);
        assert_eq!((keys, streams.len()), (vec![1, 5], 6), "a key every two seconds");
        let mut decoder = Decoder::new();
        for (i, stream) in (0..).zip(&streams) {
            let frame = decoder.decode(stream).unwrap().unwrap();
            assert_eq!((frame.width, frame.height), (62, 36));
            let error = mean_error(&frame, &picture(i, size));
            assert!(error < 3.0, "frame {i}: {error}");
        }
    }

    #[test]
    fn a_single_frame_lasts() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("orbit.mp4");
        let mut video = Video::new([32, 32], 10, None).unwrap();
        video.push(&picture(0, [32, 32])).unwrap();
        video.write(&path).unwrap();
        let (keys, streams) = samples(&path);
        assert_eq!((keys, streams.len()), (vec![1], 2));
        assert_eq!(title_of(&path).as_deref(), Some(TITLE));
        let described = |before: &[u8]| {
            let length = (8 + before.len() + TITLE.len()) as u32;
            [&length.to_be_bytes()[..], b"moov", before, TITLE.as_bytes()].concat()
        };
        let text = |length: u32| described(&[&length.to_be_bytes()[..], b"data\0\0\0\x01\0\0\0\0"].concat());
        std::fs::write(&path, text(16 + TITLE.len() as u32)).unwrap();
        assert_eq!(title_of(&path).as_deref(), Some(TITLE));
        let mut others = vec![b"not an MP4 but a longer text".to_vec(), b"\0\0\0\x08free".to_vec(), vec![]];
        others.extend([0, 1, 15, 17 + TITLE.len() as u32, u32::MAX].map(text));
        others.extend([
            described(b""),
            described(b"short"),
            b"\0\0\0\0moov".to_vec(),
            b"\xff\xff\xff\xffmoov".to_vec(),
        ]);
        for other in others {
            std::fs::write(&path, &other).unwrap();
            assert_eq!(title_of(&path), None, "{other:?}");
        }
    }

    #[test]
    fn colors_are_those_of_bt709_and_the_stream_says_so() {
        let colors =
            [([255, 255, 255], [235, 128, 128]), ([0, 0, 0], [16, 128, 128]), ([255, 0, 0], [63, 102, 240])];
        for (rgb, expected) in colors {
            let mut frame = YuvFrame::black(2, 2);
            set_bt709(&mut frame, &RgbImage::from_pixel(1, 1, Rgb(rgb)));
            assert_eq!((frame.y, frame.u[0], frame.v[0]), (vec![expected[0]; 4], expected[1], expected[2]));
        }
        let mut video = Video::new([32, 32], 10, None).unwrap();
        set_bt709(&mut video.frame, &picture(0, [32, 32]));
        let plain = video.encoder.try_encode(&video.frame).unwrap();
        let named = with_color(&plain);
        let sequence =
            |stream: &[u8]| nal_units(stream).find(|nal| nal_type(nal) == SEQUENCE).unwrap().to_vec();
        let (before, after) = (sequence(&plain), sequence(&named));
        let binary = |bytes: &[u8]| bytes.iter().map(|byte| format!("{byte:08b}")).collect::<String>();
        let flag = binary(&before).trim_end_matches('0').len() - 2;
        let expected = format!("1{}{}", "00110101", "00000001".repeat(3));
        assert_eq!(binary(&after)[flag..flag + 33], expected);
        let decoded = |stream: &[u8]| Decoder::new().decode(stream).unwrap().unwrap();
        assert!(decoded(&plain) == decoded(&named), "the pictures stay");
    }

    #[test]
    fn levels_are_the_lowest_that_fit() {
        assert_eq!(level([512, 512], 20), Some(30));
        assert_eq!(level([1920, 1080], 24), Some(40));
        assert_eq!(level([1920, 1080], 60), Some(42));
        assert_eq!(level([3840, 2160], 100), Some(60));
        assert_eq!(level([8192, 4320], 1000), Some(62));
        assert_eq!(level([16_384, 16_384], 1), None);
        // No side is longer than √8 of that of a square.
        assert_eq!(
            (level([8192, 128], 20), level([16_384, 16], 1), level([16_896, 16], 1)),
            (Some(51), Some(60), None)
        );
    }

    #[test]
    fn videos_that_cannot_be_made_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("orbit.mp4");
        assert!(Video::new([16_384, 16_384], 10, None).unwrap_err().to_string().contains("16384 × 16384"));
        let mut video = Video::new([32, 32], 10, None).unwrap();
        assert!(video.push(&picture(0, [32, 40])).unwrap_err().to_string().contains("32 × 40 pixels"));
        assert!(video.write(&path).is_err() && !path.exists());
    }
}
