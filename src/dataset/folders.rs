//! Photographs and masks in folders below a folder, looked up by path.

use crate::codec::nearby::missing_file_help;
use crate::dataset::load::{StemIndex, file_name, leads_away, spelled_as_on_disk};
use crate::dataset::masks::{find_mask, mask_file};
use crate::dataset::names::{ImageName, composed, quoted, tails, view_name};
use crate::dataset::plan::MaskPlan;
use crate::error::{Error, Result};
use std::collections::BTreeMap;
use std::path::{Component, Path, PathBuf};

/// The name of a view: the path of its image below the folder of images, without extension, as one file name. An absolute path is taken
/// without its root.
pub(super) fn flat_name(path: &str) -> String {
    let folders = Path::new(path).parent().into_iter().flat_map(Path::components);
    let named = folders.filter(|part| !matches!(part, Component::RootDir | Component::Prefix(_)));
    let folders = named.map(|part| format!("{}_", part.as_os_str().to_string_lossy()));
    folders.collect::<String>() + &view_name(path)
}

/// Image files below a folder.
pub(super) struct Folders {
    pub root: PathBuf,
    /// The folders that were looked into, by their paths below the root.
    found: BTreeMap<PathBuf, StemIndex>,
}

impl Folders {
    pub fn below(root: &Path) -> Self {
        Self { root: root.to_owned(), found: BTreeMap::new() }
    }

    /// The photograph with this path below the root.
    pub fn photograph(&mut self, name: ImageName) -> Result<PathBuf> {
        self.folder(name.as_str())?.find(name.last())
    }

    /// The path below the root by which a photograph is found: the given one, or else what is left of it without some of its folders. It
    /// is the given one if there is no such file.
    pub fn reachable(&mut self, path: &str) -> Result<String> {
        for tail in tails(path).filter(|tail| *tail == path || !leads_away(tail)) {
            let has_folder = self.root_of(tail).is_dir();
            if has_folder && self.folder(tail)?.has(&file_name(Path::new(tail))) {
                return Ok(tail.to_owned());
            }
        }
        Ok(path.to_owned())
    }

    /// The mask of the photograph with this path below the folder of photographs.
    pub fn mask(&mut self, photograph: &str) -> Result<MaskPlan> {
        let key = file_name(Path::new(photograph));
        find_mask(self.folder(photograph)?, &key).map(MaskPlan::File)
    }

    /// The mask of the photograph with this path below the data set: the folders of masks are those of photographs, but for some above
    /// them.
    pub fn mask_anywhere(&mut self, photograph: &str) -> Result<MaskPlan> {
        let mut rest = Path::new(photograph);
        loop {
            let name = rest.to_string_lossy().into_owned();
            let is_there = self.root_of(&name).is_dir();
            if is_there && let Some(mask) = mask_file(self.folder(&name)?, &file_name(rest)) {
                return Ok(MaskPlan::File(mask));
            }
            let mut parts = rest.components();
            parts.next();
            if parts.as_path().as_os_str().is_empty() {
                return self.mask(&name);
            }
            rest = parts.as_path();
        }
    }

    /// Files that are not used, given as composed paths below the root without extension.
    pub fn unused(&self, is_used: impl Fn(&Path) -> bool) -> usize {
        let stems = self.found.iter().flat_map(|(folder, index)| index.stems().map(|stem| folder.join(stem)));
        stems.filter(|path| !is_used(Path::new(composed(&path.to_string_lossy()).as_ref()))).count()
    }

    /// The folder, below the root, of the file with this path, as the disk spells it.
    fn root_of(&self, name: &str) -> PathBuf {
        let folder = self.root.join(Path::new(name).parent().unwrap_or(Path::new("")));
        spelled_as_on_disk(&folder).unwrap_or(folder)
    }

    /// The folder of the file with this path.
    fn folder(&mut self, name: &str) -> Result<&StemIndex> {
        let parent = Path::new(name).parent().unwrap_or(Path::new("")).to_owned();
        if !self.found.contains_key(&parent) {
            let folder = self.root_of(name);
            let mut index = StemIndex::of_folder(&folder)?.ok_or_else(|| {
                let problem = format!("the folder is missing, but {} should be in it", quoted(name));
                Error::input(&folder, "", problem, missing_file_help(&folder))
            })?;
            index.explains = !leads_away(name);
            self.found.insert(parent.clone(), index);
        }
        Ok(&self.found[&parent])
    }
}
