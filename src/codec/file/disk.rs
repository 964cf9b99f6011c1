//! The one file through which everything is read and written. Tests give it the faults of disks and pipes.

use std::fs::File;
use std::io::{ErrorKind, Read, Result, Seek, SeekFrom, Write};
use std::path::Path;

/// A file on the disk.
#[derive(Debug)]
pub struct DiskFile {
    file: File,
    #[cfg(test)]
    path: std::path::PathBuf,
}

impl DiskFile {
    /// A file that is open; `path` is what it is opened by.
    #[cfg_attr(not(test), allow(unused_variables))]
    pub(super) fn new(file: File, path: &Path) -> Self {
        Self {
            file,
            #[cfg(test)]
            path: path.to_owned(),
        }
    }

    /// Opens a file for reading.
    pub(in crate::codec) fn open(path: &Path) -> Result<Self> {
        File::open(path).map(|file| Self::new(file, path))
    }

    /// What the system says of it.
    ///
    /// # Errors
    /// Those of the system.
    pub fn metadata(&self) -> Result<std::fs::Metadata> {
        self.file.metadata()
    }

    /// Reads once, and meets the faults of tests.
    fn read_once(&mut self, buffer: &mut [u8]) -> Result<usize> {
        #[cfg(test)]
        let buffer = {
            let length = super::faults::meet(&self.path, super::faults::Call::Read, buffer.len())?;
            &mut buffer[..length]
        };
        self.file.read(buffer)
    }

    /// Writes once, and meets the faults of tests.
    fn write_once(&mut self, buffer: &[u8]) -> Result<usize> {
        #[cfg(test)]
        let buffer = &buffer[..super::faults::meet(&self.path, super::faults::Call::Write, buffer.len())?];
        self.file.write(buffer)
    }

    /// Puts its bytes on the disk.
    pub(super) fn sync_all(&self) -> Result<()> {
        #[cfg(test)]
        super::faults::meet(&self.path, super::faults::Call::Sync, 0)?;
        self.file.sync_all()
    }
}

/// Tries again what a signal has interrupted: not every decoder does.
fn uninterrupted(mut call: impl FnMut() -> Result<usize>) -> Result<usize> {
    loop {
        match call() {
            Err(error) if error.kind() == ErrorKind::Interrupted => {}
            ended => return ended,
        }
    }
}

impl Read for DiskFile {
    fn read(&mut self, buffer: &mut [u8]) -> Result<usize> {
        uninterrupted(|| self.read_once(buffer))
    }
}

impl Write for DiskFile {
    fn write(&mut self, buffer: &[u8]) -> Result<usize> {
        uninterrupted(|| self.write_once(buffer))
    }

    fn flush(&mut self) -> Result<()> {
        self.file.flush()
    }
}

impl Seek for DiskFile {
    fn seek(&mut self, to: SeekFrom) -> Result<u64> {
        self.file.seek(to)
    }
}
