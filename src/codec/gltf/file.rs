//! The container of a glTF: JSON, buffers, and checked reading of accessors.
//!
//! The `gltf` crate supplies the JSON types. Its readers assume a validated file and panic on some invalid ones, so every
//! index, offset and length is checked here instead.

use crate::codec::file::{first_bytes, open, read_bytes};
use crate::codec::nearby::missing_file_help;
use crate::{Error, Result};
use gltf::json::accessor::{ComponentType, Type};
use gltf::json::validation::Checked;
use gltf::json::{self, Index, Root};
use std::io::Read as _;
use std::path::{Path, PathBuf};

/// A file with more elements than this in one accessor is assumed to be damaged. Sparse accessors need no bytes for them.
pub(super) const MAX_ELEMENTS: u64 = 30_000_000;
/// Most bytes of all buffers together.
const MAX_BYTES: u64 = 4 << 30;

/// A parsed file with all its buffers in memory.
pub(super) struct GltfFile {
    pub(super) path: PathBuf,
    pub(super) root: Root,
    buffers: Vec<Vec<u8>>,
}

/// The location of the elements of an accessor.
struct Layout<'a> {
    bytes: &'a [u8],
    stride: usize,
}

impl GltfFile {
    /// Reads `path` and every buffer that it names.
    pub(super) fn open(path: &Path) -> Result<Self> {
        let bytes = read_bytes(path, missing_file_help)?;
        let (text, blob) =
            if bytes.starts_with(b"glTF") { split_glb(path, &bytes)? } else { (bytes.as_slice(), None) };
        let root = Root::from_slice(text).map_err(|e| {
            Error::input(
                path,
                "",
                format!("not a readable glTF 2.0 file: {e}"),
                "give a .glb or .gltf file, and check that it was copied completely",
            )
        })?;
        let mut file = Self { path: path.to_owned(), root, buffers: Vec::new() };
        file.check_extensions()?;
        let wanted = file.root.buffers.iter().fold(0_u64, |sum, b| sum.saturating_add(b.byte_length.0));
        if wanted > MAX_BYTES {
            return Err(file.error("buffers", format!("claim {wanted} bytes, more than {MAX_BYTES}")));
        }
        file.buffers =
            (0..file.root.buffers.len()).map(|index| file.read_buffer(index, blob)).collect::<Result<_>>()?;
        Ok(file)
    }

    /// An error about this file.
    pub(super) fn error(&self, place: impl Into<String>, problem: impl Into<String>) -> Error {
        Error::input(&self.path, place, problem, "export the mesh again, or check it with a glTF validator")
    }

    /// Looks up `index` among `items` ("accessor", "mesh"…).
    pub(super) fn item<'a, T>(
        &self,
        items: &'a [T],
        index: Index<T>,
        kind: &str,
        place: &str,
    ) -> Result<&'a T> {
        items.get(index.value()).ok_or_else(|| {
            self.error(place, format!("refers to {kind} {}, but the file has {}", index.value(), items.len()))
        })
    }

    fn check_extensions(&self) -> Result<()> {
        let harmless = |name: &str| {
            ["KHR_materials_", "KHR_texture_", "EXT_texture_", "KHR_lights_", "KHR_mesh_quantization"]
                .iter()
                .any(|prefix| name.starts_with(prefix))
        };
        match self.root.extensions_required.iter().find(|name| !harmless(name)) {
            None => Ok(()),
            Some(name) => Err(Error::input(
                &self.path,
                "extensionsRequired",
                format!("the file needs the extension {name}, which is not supported"),
                "export the mesh without compression and without required extensions",
            )),
        }
    }

    fn read_buffer(&self, index: usize, blob: Option<&[u8]>) -> Result<Vec<u8>> {
        let place = format!("buffer {index}");
        let buffer = &self.root.buffers[index];
        let mut bytes = match (&buffer.uri, blob) {
            (Some(uri), _) => self.read_uri(uri, &place)?,
            (None, Some(blob)) if index == 0 => blob.to_vec(),
            (None, _) => return Err(self.error(place, "has no data: neither a URI nor a binary chunk")),
        };
        if (bytes.len() as u64) < buffer.byte_length.0 {
            let (found, wanted) = (bytes.len(), buffer.byte_length.0);
            return Err(self.error(place, format!("is truncated: {found} bytes of {wanted}")));
        }
        // The rest is padding, or another buffer's.
        bytes.truncate(buffer.byte_length.0 as usize);
        bytes.shrink_to_fit();
        Ok(bytes)
    }

    fn read_uri(&self, uri: &str, place: &str) -> Result<Vec<u8>> {
        if uri.starts_with("data:") {
            let source = gltf::buffer::Source::Uri(uri);
            return gltf::buffer::Data::from_source(source, None)
                .map(|data| data.0)
                .map_err(|e| self.error(place, format!("its data URI cannot be decoded: {e}")));
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
    pub(super) fn image(&self, index: Index<json::Image>, place: &str) -> Result<Vec<u8>> {
        let image = self.item(&self.root.images, index, "image", place)?;
        let place = format!("{place}, image {}", index.value());
        match (image.buffer_view, &image.uri) {
            (Some(view), _) => {
                let length = self.item(&self.root.buffer_views, view, "buffer view", &place)?.byte_length.0;
                // Within a buffer, as `layout` checks.
                Ok(self.layout(view, 0, length as usize, 1, &place)?.bytes.to_vec())
            }
            (None, Some(uri)) => self.read_uri(uri, &place),
            (None, None) => Err(self.error(place, "has no data: neither a URI nor a buffer view")),
        }
    }

    /// The number of elements that accessor `index` claims to have.
    pub(super) fn count(&self, index: Index<json::Accessor>, place: &str) -> Result<u64> {
        Ok(self.item(&self.root.accessors, index, "accessor", place)?.count.0)
    }

    /// The elements of accessor `index` as floats, `N` components each; integers are scaled if "normalized".
    pub(super) fn floats<const N: usize>(
        &self,
        index: Index<json::Accessor>,
        place: &str,
    ) -> Result<Vec<[f32; N]>> {
        let accessor = self.item(&self.root.accessors, index, "accessor", place)?;
        let place = format!("{place}, accessor {}", index.value());
        let (component, components) = self.element_type(accessor, &place)?;
        if components != N {
            return Err(
                self.error(place, format!("has {components} components per element where {N} are needed"))
            );
        }
        let normalized = accessor.normalized;
        self.elements(accessor, component, N, &place, |bytes| {
            std::array::from_fn(|k| float_at(&bytes[k * component.size()..], component, normalized))
        })
    }

    /// The elements of accessor `index` as vertex indices.
    pub(super) fn indices(&self, index: Index<json::Accessor>, place: &str) -> Result<Vec<u32>> {
        let accessor = self.item(&self.root.accessors, index, "accessor", place)?;
        let place = format!("{place}, accessor {}", index.value());
        let (component, components) = self.element_type(accessor, &place)?;
        let unsigned = matches!(component, ComponentType::U8 | ComponentType::U16 | ComponentType::U32);
        if components != 1 || !unsigned {
            return Err(self.error(place, "vertex indices must be unsigned integer scalars"));
        }
        self.elements(accessor, component, 1, &place, |bytes| unsigned_at(bytes, component))
    }

    fn element_type(&self, accessor: &json::Accessor, place: &str) -> Result<(ComponentType, usize)> {
        let components = match accessor.type_ {
            Checked::Valid(Type::Scalar) => 1,
            Checked::Valid(Type::Vec2) => 2,
            Checked::Valid(Type::Vec3) => 3,
            Checked::Valid(Type::Vec4) => 4,
            _ => return Err(self.error(place, "has a type that vertex data cannot have")),
        };
        match accessor.component_type {
            Checked::Valid(component) => Ok((component.0, components)),
            Checked::Invalid => Err(self.error(place, "has an unknown component type")),
        }
    }

    /// Decodes all elements; sparse elements replace dense ones (or zeros, where there is no buffer view).
    fn elements<T: Clone>(
        &self,
        accessor: &json::Accessor,
        component: ComponentType,
        components: usize,
        place: &str,
        decode: impl Fn(&[u8]) -> T,
    ) -> Result<Vec<T>> {
        let size = component.size() * components;
        let count = self.element_count(accessor.count.0, place)?;
        let mut values = match accessor.buffer_view {
            None if accessor.sparse.is_none() => return Err(self.error(place, "has no data")),
            None => vec![decode(&[0; 16][..size]); count],
            Some(view) => {
                let offset = accessor.byte_offset.map_or(0, |o| o.0);
                let layout = self.layout(view, offset, count, size, place)?;
                (0..count).map(|i| decode(&layout.bytes[i * layout.stride..][..size])).collect()
            }
        };
        if let Some(sparse) = &accessor.sparse {
            let changed = self.element_count(sparse.count.0, place)?;
            let Checked::Valid(index_type) = sparse.indices.component_type else {
                return Err(self.error(place, "has sparse indices of an unknown type"));
            };
            let (at, from) = (&sparse.indices, &sparse.values);
            let where_to =
                self.layout(at.buffer_view, at.byte_offset.0, changed, index_type.0.size(), place)?;
            let what = self.layout(from.buffer_view, from.byte_offset.0, changed, size, place)?;
            for i in 0..changed {
                let target = unsigned_at(&where_to.bytes[i * where_to.stride..], index_type.0) as usize;
                let slot = values.get_mut(target).ok_or_else(|| {
                    self.error(place, format!("sparse index {target} is beyond its {count} elements"))
                })?;
                *slot = decode(&what.bytes[i * what.stride..][..size]);
            }
        }
        Ok(values)
    }

    fn element_count(&self, count: u64, place: &str) -> Result<usize> {
        match count {
            0..=MAX_ELEMENTS => Ok(count as usize),
            _ => Err(self.error(place, format!("claims {count} elements, more than {MAX_ELEMENTS}"))),
        }
    }

    /// The bytes of `count` elements of `size` bytes from `offset` in a buffer view, all within the view and its buffer.
    fn layout(
        &self,
        view: Index<json::buffer::View>,
        offset: u64,
        count: usize,
        size: usize,
        place: &str,
    ) -> Result<Layout<'_>> {
        let view_place = format!("{place}, buffer view {}", view.value());
        let view = self.item(&self.root.buffer_views, view, "buffer view", place)?;
        self.item(&self.root.buffers, view.buffer, "buffer", &view_place)?;
        let stride = view.byte_stride.map_or(size, |stride| stride.0.max(size));
        if count == 0 {
            return Ok(Layout { bytes: &[], stride });
        }
        let buffer = &self.buffers[view.buffer.value()];
        let start = view.byte_offset.map_or(0, |o| o.0);
        let view_bytes = checked_slice(buffer, start, view.byte_length.0).ok_or_else(|| {
            self.error(view_place, format!("reaches beyond its buffer of {} bytes", buffer.len()))
        })?;
        let needed = (stride as u64).saturating_mul(count as u64 - 1).saturating_add(size as u64);
        let bytes = checked_slice(view_bytes, offset, needed).ok_or_else(|| {
            let problem =
                format!("is out of range: needs {needed} bytes from {offset} of {}", view_bytes.len());
            self.error(place, problem)
        })?;
        Ok(Layout { bytes, stride })
    }
}

/// The files that a `.glb` or `.gltf` file names: buffers, and images that are not in a buffer. A file that cannot be read names none; what
/// is wrong with it is said when it is read.
pub(crate) fn side_files(path: &Path) -> Vec<PathBuf> {
    let Some(root) = read_json(path).and_then(|text| Root::from_slice(&text).ok()) else { return Vec::new() };
    let buffers = root.buffers.iter().map(|buffer| buffer.uri.as_ref());
    let images = root.images.iter().map(|image| image.uri.as_ref());
    let uris =
        buffers.chain(images).flatten().filter(|uri| !uri.starts_with("data:") && !uri.contains("://"));
    uris.filter_map(|uri| file_of(path, uri)).collect()
}

/// The file that a URI in the glTF file at `path` names; `None` if it is not UTF-8.
fn file_of(path: &Path, uri: &str) -> Option<PathBuf> {
    Some(path.parent().unwrap_or(Path::new("")).join(percent_decoded(uri)?))
}

/// The JSON of a `.glb` or `.gltf` file, without the buffer of the first; `None` if it cannot be read.
fn read_json(path: &Path) -> Option<Vec<u8>> {
    let mut file = open(path, missing_file_help).ok()?;
    let head = first_bytes(path, &mut file, 20).ok()?;
    if !head.starts_with(b"glTF") {
        return read_bytes(path, missing_file_help).ok();
    }
    let length = u32::from_le_bytes(head.get(12..16)?.try_into().ok()?);
    let mut bytes = Vec::new();
    file.take(20 + u64::from(length)).read_to_end(&mut bytes).ok()?;
    Some(bytes.split_off(20.min(bytes.len())))
}

/// The JSON chunk and the binary chunk of a GLB (glTF 2.0 specification, section 4).
fn split_glb<'a>(path: &Path, bytes: &'a [u8]) -> Result<(&'a [u8], Option<&'a [u8]>)> {
    let help = "check that the file was copied completely, or export it again";
    let word = |at: usize| bytes.get(at..at + 4).map(|b| u32::from_le_bytes([b[0], b[1], b[2], b[3]]));
    let truncated =
        || Error::input(path, "", format!("is truncated: it ends after {} bytes", bytes.len()), help);
    let version = word(4).ok_or_else(truncated)?;
    if version != 2 {
        return Err(Error::input(path, "", format!("is binary glTF version {version}, not 2"), help));
    }
    if (word(8).ok_or_else(truncated)? as usize) > bytes.len() {
        return Err(truncated());
    }
    let chunk = |at: usize| -> Result<&'a [u8]> {
        let length = word(at).ok_or_else(truncated)?;
        checked_slice(bytes, at as u64 + 8, u64::from(length)).ok_or_else(truncated)
    };
    if word(16) != Some(u32::from_le_bytes(*b"JSON")) {
        return Err(Error::input(path, "", "does not begin with a JSON chunk", help));
    }
    let text = chunk(12)?;
    let next = 20 + text.len().next_multiple_of(4);
    let blob = match word(next + 4) {
        Some(kind) if kind == u32::from_le_bytes(*b"BIN\0") => Some(chunk(next)?),
        _ => None,
    };
    Ok((text, blob))
}

fn checked_slice(bytes: &[u8], start: u64, length: u64) -> Option<&[u8]> {
    let start = usize::try_from(start).ok()?;
    let end = start.checked_add(usize::try_from(length).ok()?)?;
    bytes.get(start..end)
}

fn percent_decoded(uri: &str) -> Option<String> {
    let mut out = Vec::with_capacity(uri.len());
    let bytes = uri.as_bytes();
    let mut at = 0;
    while at < bytes.len() {
        let hex = bytes.get(at + 1..at + 3).and_then(|h| std::str::from_utf8(h).ok());
        match (bytes[at], hex.and_then(|h| u8::from_str_radix(h, 16).ok())) {
            (b'%', Some(value)) => {
                out.push(value);
                at += 3;
            }
            (byte, _) => {
                out.push(byte);
                at += 1;
            }
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
    fn percent_sequences() {
        assert_eq!(percent_decoded("a%20b%2Fc").as_deref(), Some("a b/c"));
        assert_eq!(percent_decoded("50%").as_deref(), Some("50%"));
        assert_eq!(percent_decoded("%ff"), None);
    }

    #[test]
    fn normalized_integers() {
        assert_eq!(float_at(&[0x80], ComponentType::I8, true), -1.0);
        assert_eq!(float_at(&[0xff], ComponentType::U8, true), 1.0);
        assert_eq!(float_at(&[0xff, 0xff], ComponentType::I16, false), -1.0);
        assert_eq!(float_at(&[0, 0, 0x80, 0x3f], ComponentType::F32, false), 1.0);
    }
}
