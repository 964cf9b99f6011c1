//! Reading and writing of glTF 2.0: triangle meshes and their material.
//!
//! The crate `gltf-json` supplies the JSON types; every index, offset and length is checked here.

pub mod export;
pub mod import;
pub mod material;

use crate::codec::{file::read_bytes, nearby::missing_file_help};
use base64::{Engine as _, engine::general_purpose::STANDARD};
use gltf_json::{self as json, Index, Root, accessor::ComponentType, accessor::Type, validation::Checked};
use lobelia_geometry::{Error, Result};
use std::path::{Path, PathBuf};

/// Most bytes of all buffers together.
const MAX_BYTES: u64 = 4 << 30;

/// A parsed file with all its buffers in memory.
struct GltfFile {
    path: PathBuf,
    root: Root,
    buffers: Vec<Vec<u8>>,
}

impl GltfFile {
    /// Reads `path` and every buffer that it names.
    fn open(path: &Path) -> Result<Self> {
        let (root, blob) = document(path)?;
        let mut file = Self { path: path.to_owned(), root, buffers: Vec::new() };
        let harmless =
            ["KHR_materials_", "KHR_texture_", "EXT_texture_", "KHR_lights_", "KHR_mesh_quantization"];
        let is_harmless = |name: &String| harmless.iter().any(|prefix| name.starts_with(prefix));
        if let Some(name) = file.root.extensions_required.iter().find(|name| !is_harmless(name)) {
            let problem = format!("the file needs the extension {name}, which is not supported");
            let help = "export the mesh without compression and without required extensions";
            return Err(Error::input(path, "extensionsRequired", problem, help));
        }
        let wanted = file.root.buffers.iter().fold(0_u64, |sum, b| sum.saturating_add(b.byte_length.0));
        if wanted > MAX_BYTES {
            return Err(file.error("buffers", format!("claim {wanted} bytes, more than {MAX_BYTES}")));
        }
        let buffers = (0..file.root.buffers.len()).map(|index| file.read_buffer(index, blob.as_deref()));
        file.buffers = buffers.collect::<Result<_>>()?;
        Ok(file)
    }

    /// An error about this file.
    fn error(&self, place: impl Into<String>, problem: impl Into<String>) -> Error {
        Error::input(&self.path, place, problem, "export the mesh again, or check it with a glTF validator")
    }

    /// Looks up `index` among `items` ("accessor", "mesh"…).
    fn item<'a, T>(&self, items: &'a [T], index: Index<T>, kind: &str, place: &str) -> Result<&'a T> {
        items.get(index.value()).ok_or_else(|| {
            self.error(place, format!("refers to {kind} {}, but the file has {}", index.value(), items.len()))
        })
    }

    fn read_buffer(&self, index: usize, blob: Option<&[u8]>) -> Result<Vec<u8>> {
        let place = format!("buffer {index}");
        let buffer = &self.root.buffers[index];
        let mut bytes = match (&buffer.uri, blob) {
            (Some(uri), _) => self.read_uri(uri, &place)?,
            (None, Some(blob)) if index == 0 => blob.to_vec(),
            (None, _) => return Err(self.error(place, "has no data: neither a URI nor a binary chunk")),
        };
        let (found, wanted) = (bytes.len(), buffer.byte_length.0);
        if (found as u64) < wanted {
            return Err(self.error(place, format!("is truncated: {found} bytes of {wanted}")));
        }
        // The rest is padding, or another buffer's.
        bytes.truncate(wanted as usize);
        bytes.shrink_to_fit();
        Ok(bytes)
    }

    fn read_uri(&self, uri: &str, place: &str) -> Result<Vec<u8>> {
        if let Some(data) = uri.strip_prefix("data:") {
            let decoded = data.split_once(";base64,").and_then(|(_, text)| STANDARD.decode(text).ok());
            return decoded
                .ok_or_else(|| self.error(place, "its data URI cannot be decoded: it is not base64"));
        }
        if uri.contains("://") {
            return Err(self.error(place, format!("lies outside the file system: {uri}")));
        }
        let file = file_of(&self.path, uri)
            .ok_or_else(|| self.error(place, format!("has a URI that is not valid UTF-8: {uri}")))?;
        read_bytes(&file, missing_file_help).map_err(|e| {
            let problem = format!("its data file cannot be read: {e}");
            Error::input(&self.path, place, problem, "keep the .bin files beside the .gltf, or use one .glb")
        })
    }

    /// The bytes of image file `index`, embedded or beside the file.
    fn image(&self, index: Index<json::Image>, place: &str) -> Result<Vec<u8>> {
        let image = self.item(&self.root.images, index, "image", place)?;
        let place = format!("{place}, image {}", index.value());
        match (image.buffer_view, &image.uri) {
            (Some(view), _) => Ok(self.view(view, &place)?.0.to_vec()),
            (None, Some(uri)) => self.read_uri(uri, &place),
            (None, None) => Err(self.error(place, "has no data: neither a URI nor a buffer view")),
        }
    }

    /// The bytes of a buffer view, and how far apart its elements are if it says so.
    fn view(&self, index: Index<json::buffer::View>, place: &str) -> Result<(&[u8], Option<usize>)> {
        let view = self.item(&self.root.buffer_views, index, "buffer view", place)?;
        let place = format!("{place}, buffer view {}", index.value());
        self.item(&self.root.buffers, view.buffer, "buffer", &place)?;
        let buffer = &self.buffers[view.buffer.value()];
        let start = view.byte_offset.map_or(0, |offset| offset.0);
        let bytes = checked_slice(buffer, start, view.byte_length.0).ok_or_else(|| {
            self.error(place, format!("reaches beyond its buffer of {} bytes", buffer.len()))
        })?;
        Ok((bytes, view.byte_stride.map(|stride| stride.0)))
    }

    /// The number of elements that accessor `index` claims to have.
    fn count(&self, index: Index<json::Accessor>, place: &str) -> Result<u64> {
        Ok(self.item(&self.root.accessors, index, "accessor", place)?.count.0)
    }

    /// The elements of accessor `index` as floats, `N` components each; integers are scaled if
    /// "normalized".
    fn floats<const N: usize>(&self, index: Index<json::Accessor>, place: &str) -> Result<Vec<[f32; N]>> {
        let (component, elements) = self.elements(index, N, place)?;
        let is_normalized = self.root.accessors[index.value()].normalized;
        let float = |raw: &[u8], k: usize| float_at(&raw[k * component.size()..], component, is_normalized);
        Ok(elements.map(|bytes| std::array::from_fn(|k| float(bytes, k))).collect())
    }

    /// The elements of accessor `index` as vertex indices.
    fn indices(&self, index: Index<json::Accessor>, place: &str) -> Result<Vec<u32>> {
        let (component, elements) = self.elements(index, 1, place)?;
        if !matches!(component, ComponentType::U8 | ComponentType::U16 | ComponentType::U32) {
            let place = format!("{place}, accessor {}", index.value());
            return Err(self.error(place, "vertex indices must be unsigned integers"));
        }
        Ok(elements.map(|bytes| unsigned_at(bytes, component)).collect())
    }

    /// The type of the components of accessor `index`, and the bytes of its elements of `wanted`
    /// components each, all within its buffer view.
    fn elements(
        &self,
        index: Index<json::Accessor>,
        wanted: usize,
        place: &str,
    ) -> Result<(ComponentType, impl Iterator<Item = &[u8]>)> {
        let accessor = self.item(&self.root.accessors, index, "accessor", place)?;
        let place = format!("{place}, accessor {}", index.value());
        let components = match accessor.type_ {
            Checked::Valid(Type::Scalar) => 1,
            Checked::Valid(Type::Vec2) => 2,
            Checked::Valid(Type::Vec3) => 3,
            Checked::Valid(Type::Vec4) => 4,
            _ => return Err(self.error(place, "has a type that vertex data cannot have")),
        };
        if components != wanted {
            let problem = format!("has {components} components per element where {wanted} are needed");
            return Err(self.error(place, problem));
        }
        let Checked::Valid(component) = accessor.component_type else {
            return Err(self.error(place, "has an unknown component type"));
        };
        let view = match (accessor.buffer_view, &accessor.sparse) {
            (Some(view), None) => view,
            (_, Some(_)) => return Err(self.error(place, "is sparse, which is not read")),
            (None, None) => return Err(self.error(place, "has no data")),
        };
        let (view, stride) = self.view(view, &place)?;
        let size = component.0.size() * components;
        let (stride, count) = (stride.map_or(size, |stride| stride.max(size)), accessor.count.0);
        let offset = accessor.byte_offset.map_or(0, |offset| offset.0);
        let needed = match count {
            0 => 0,
            _ => (count - 1).saturating_mul(stride as u64).saturating_add(size as u64),
        };
        let bytes = checked_slice(view, offset, needed).ok_or_else(|| {
            let problem = format!("is out of range: needs {needed} bytes from {offset} of {}", view.len());
            self.error(place, problem)
        })?;
        Ok((component.0, (0..count as usize).map(move |i| &bytes[i * stride..][..size])))
    }
}

/// The files that a `.glb` or `.gltf` file names: buffers, and images that are not in a buffer. A
/// file that cannot be read names none; what is wrong with it is said when it is read.
pub fn side_files(path: &Path) -> Vec<PathBuf> {
    let Ok((root, _)) = document(path) else { return Vec::new() };
    let buffers = root.buffers.iter().map(|buffer| buffer.uri.as_ref());
    let images = root.images.iter().map(|image| image.uri.as_ref());
    let is_file = |uri: &&String| !uri.starts_with("data:") && !uri.contains("://");
    buffers.chain(images).flatten().filter(is_file).filter_map(|uri| file_of(path, uri)).collect()
}

/// The file that a URI in the glTF file at `path` names; `None` if it is not UTF-8.
fn file_of(path: &Path, uri: &str) -> Option<PathBuf> {
    Some(path.parent().unwrap_or(Path::new("")).join(percent_decoded(uri)?))
}

/// The document of a `.glb` or `.gltf` file, and the binary chunk of the first (glTF 2.0
/// specification, section 4).
fn document(path: &Path) -> Result<(Root, Option<Vec<u8>>)> {
    let bytes = read_bytes(path, missing_file_help)?;
    let wrong = |problem: String| {
        Error::input(path, "", problem, "check that the file was copied completely, or export it again")
    };
    let word = |at: usize| bytes.get(at..)?.first_chunk().map(|word| u32::from_le_bytes(*word));
    let chunk = |at: usize, kind: &[u8]| {
        let data = bytes.get(at + 4..)?.strip_prefix(kind)?;
        data.get(..word(at)? as usize)
    };
    let (mut text, mut blob) = (bytes.as_slice(), None);
    if bytes.starts_with(b"glTF") {
        match (word(4), word(8)) {
            (Some(v), _) if v != 2 => return Err(wrong(format!("is binary glTF version {v}, not 2"))),
            (_, Some(length)) if length as usize <= bytes.len() => {}
            _ => return Err(wrong(format!("is truncated: it ends after {} bytes", bytes.len()))),
        }
        text = chunk(12, b"JSON").ok_or_else(|| wrong("does not begin with a JSON chunk".to_owned()))?;
        blob = chunk(20 + text.len().next_multiple_of(4), b"BIN\0").map(<[u8]>::to_vec);
    }
    let root = Root::from_slice(text).map_err(|e| wrong(format!("not a readable glTF 2.0 file: {e}")))?;
    Ok((root, blob))
}

fn checked_slice(bytes: &[u8], start: u64, length: u64) -> Option<&[u8]> {
    bytes.get(usize::try_from(start).ok()?..)?.get(..usize::try_from(length).ok()?)
}

fn percent_decoded(uri: &str) -> Option<String> {
    let mut parts = uri.split('%');
    let mut out = parts.next()?.as_bytes().to_vec();
    for part in parts {
        match part.get(..2).and_then(|hex| u8::from_str_radix(hex, 16).ok()) {
            Some(byte) => out.extend([&[byte], &part.as_bytes()[2..]].concat()),
            None => out.extend([b"%", part.as_bytes()].concat()),
        }
    }
    String::from_utf8(out).ok()
}

fn unsigned_at(bytes: &[u8], component: ComponentType) -> u32 {
    match component.size() {
        1 => u32::from(bytes[0]),
        2 => u32::from(u16::from_le_bytes([bytes[0], bytes[1]])),
        _ => u32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]),
    }
}

/// One component as a float; "normalized" integers as the specification's section 3.11 says.
fn float_at(bytes: &[u8], component: ComponentType, normalized: bool) -> f32 {
    let raw = unsigned_at(bytes, component);
    let (value, top) = match component {
        ComponentType::F32 => return f32::from_bits(raw),
        ComponentType::I8 => (f32::from(raw as u8 as i8), 127.0),
        ComponentType::U8 => (raw as f32, 255.0),
        ComponentType::I16 => (f32::from(raw as u16 as i16), 32767.0),
        ComponentType::U16 => (raw as f32, 65535.0),
        ComponentType::U32 => (raw as f32, u32::MAX as f32),
    };
    if normalized { (value / top).max(-1.0) } else { value }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn normalized_integers() {
        assert_eq!(float_at(&[0x80], ComponentType::I8, true), -1.0);
        assert_eq!(float_at(&[0xff], ComponentType::U8, true), 1.0);
        assert_eq!(float_at(&[0xff, 0xff], ComponentType::I16, false), -1.0);
        assert_eq!(float_at(&[0, 0, 0x80, 0x3f], ComponentType::F32, false), 1.0);
    }
}
