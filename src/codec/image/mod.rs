//! Reading photographs and masks: PNG, JPEG, TIFF, WebP, OpenEXR and Radiance HDR.
//!
//! The first bytes of a file determine its format, whatever its name. Embedded color profiles and gamma
//! chunks are ignored: [`Gamma`] says how 8- and 16-bit values are read. Headers are read and checked before pixels are decoded.
//! [`decode_photograph`] gives pixels as compact as the file has them; [`read_image`] and
//! [`read_mask`] convert these to linear radiance and coverage.
//!
//! [`encode_jpeg`] and [`encode_png`] are for pictures in memory, such as those that a page holds.

mod decode;
mod encode;
mod format;
mod header;
mod jpeg_file;
mod mask;
mod photograph;
mod repair;
mod samples;
mod tiff_file;
mod webp_file;

pub use decode::decode_picture;
pub(crate) use decode::{decode_samples, image_header};
pub(crate) use encode::decode;
pub use encode::{PngPixels, encode_jpeg, encode_png};
pub use format::{Format, IMAGE_EXTENSIONS};
pub(crate) use format::{is_unread_name, is_video_start};
pub use header::{ImageHeader, Orientation};
pub use mask::{LoadedMask, read_mask};
pub(crate) use photograph::linear_image;
pub use photograph::{Gamma, LoadedImage, decode_photograph, read_image};
pub(crate) use repair::BRIGHTEST;
pub use repair::Repairs;
pub use samples::{Decoded, ImageSamples};

#[cfg(test)]
mod tests;
