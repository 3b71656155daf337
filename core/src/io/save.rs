//! Files that appear whole or not at all, alone ([`Temporary`]) or several of a folder together ([`Saving`]).
//!
//! Whenever the process is killed or a call fails, the folder of a [`Saving`] holds all the old files or all the new ones:
//! 1. Every new file is written under a temporary name and reaches the disk.
//! 2. A [`Record`] of what takes whose place is written likewise and renamed to [`RECORD`]. From here on the folder holds the new files.
//! 3. The temporary files are renamed, what is not needed any more is removed, at last the record.
//!
//! A save that is cancelled before step 3 ends as if it had never begun; then it is carried out.
//!
//! After a kill there are temporary files that mean nothing, or a record, and with it all that step 3 needs: the next save or load carries it out.
//! A load that may not write finds its files by the record ([`read_whole`]).
//!
//! A save has its folder alone, by a lock of the operating system on the folder, which ends with the process: who has it knows that other temporary
//! files are of dead runs. A [`Temporary`] shares the lock, so that nobody clears it away. On file systems without such locks these files stay.

use std::collections::{BTreeMap, BTreeSet};
use std::fs::{File, TryLockError};
use std::io::{self, ErrorKind, Write};
use std::path::{Component, Path, PathBuf};
use std::time::{Duration, Instant};

use serde::{Deserialize, Serialize};
use tempfile::NamedTempFile;

use super::file::read_file_unless;
use super::read_file;
use crate::cancel::CancelToken;
use crate::error::{Error, Result};

/// The record of a save that is being carried out.
const RECORD: &str = ".svbrdf-gcn-save.json";
const FORMAT: &str = "svbrdf-gcn save";
const VERSION: u64 = 1;
const MAX_RECORD_BYTES: u64 = 1 << 20;

/// How the names of temporary files begin and end.
const TEMPORARY: (&str, &str) = (".svbrdf-gcn-", ".tmp");

/// How long a save waits for another one in the same folder, and between two looks.
const PATIENCE: Duration = Duration::from_secs(60);
const PAUSE: Duration = Duration::from_millis(20);
/// How often a load begins again because files were replaced while it read.
const READINGS: usize = 10;

/// A file that is written beside its place and then put there.
pub(crate) struct Temporary {
    // Dropped, and so removed, before the folder is unlocked.
    file: NamedTempFile,
    _shared: Option<Lock>,
}

impl Temporary {
    /// An empty file in the folder of `path`.
    pub fn beside(path: &Path) -> Result<Self> {
        let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
        let shared = Lock::wait(folder, Share::Others, &CancelToken::new())?;
        Ok(Self { file: temporary_in(folder).map_err(|e| Error::io(path, e))?, _shared: shared })
    }

    /// Replaces `path` by the file once it has reached the disk.
    pub fn persist(self, path: &Path) -> Result<()> {
        disk::sync(self.file.as_file()).map_err(|e| Error::io(path, e))?;
        disk::rename(self.file.path(), path).map_err(|e| Error::io(path, e))?;
        // Nothing is left to be removed.
        drop(self.file.into_temp_path().keep());
        disk::sync_folder(path.parent().unwrap_or(Path::new(""))).map_err(|e| Error::io(path, e))
    }
}

impl Write for Temporary {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.file.write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.file.flush()
    }
}

/// Replaces `path` by a file of `bytes`.
pub(crate) fn write_file(path: &Path, bytes: &[u8]) -> Result<()> {
    let mut file = Temporary::beside(path)?;
    disk::write(&mut file.file, bytes).map_err(|e| Error::io(path, e))?;
    file.persist(path)
}

/// A folder whose files are about to be replaced; nobody else saves there meanwhile.
pub(crate) struct Saving<'a> {
    folder: &'a Path,
    cancel: &'a CancelToken,
    _made: Made,
    _alone: Option<Lock>,
}

/// The folders that a save made, innermost first. Those that are empty in the end go again.
struct Made(Vec<PathBuf>);

impl Made {
    /// Makes `folder` and what it lies in, as far as they are not there.
    fn make(folder: &Path) -> Result<Self> {
        let missing = folder.ancestors().take_while(|place| !place.as_os_str().is_empty() && !place.exists());
        let made = Self(missing.map(Path::to_owned).collect());
        std::fs::create_dir_all(folder).map_err(|e| Error::io(folder, e))?;
        Ok(made)
    }
}

impl Drop for Made {
    fn drop(&mut self) {
        for folder in &self.0 {
            // Whatever is not empty stays.
            drop(std::fs::remove_dir(folder));
        }
    }
}

impl<'a> Saving<'a> {
    /// Makes the folder where it is not there, waits for other saves to end, and finishes what dead ones began.
    ///
    /// Until the files are about to take their places the save ends once `cancel` is cancelled, and leaves nothing.
    pub fn begin(folder: &'a Path, cancel: &'a CancelToken) -> Result<Self> {
        cancel.check()?;
        let made = Made::make(folder)?;
        let alone = Lock::wait(folder, Share::Nobody, cancel)?;
        recover(folder, alone.as_ref())?;
        Ok(Self { folder, cancel, _made: made, _alone: alone })
    }

    /// Puts `files` (names and contents) into the folder and removes the files named by `remove`, all or nothing.
    ///
    /// An error that says so leaves the new files, of which the next save or load puts those in place that are not yet; any other the old ones.
    pub fn replace(self, files: &[(String, Vec<u8>)], remove: BTreeSet<String>) -> Result<()> {
        let write = |name: &str, bytes: &[u8]| {
            self.cancel.check()?;
            let path = self.folder.join(name);
            let mut file = temporary_in(self.folder).map_err(|e| Error::io(&path, e))?;
            let written = disk::write(&mut file, bytes).and_then(|()| disk::sync(file.as_file()));
            written.map_err(|e| Error::io(&path, e))?;
            Ok(file)
        };
        let written = files.iter().map(|(name, bytes)| write(name, bytes)).collect::<Result<Vec<_>>>()?;
        let base = |file: &NamedTempFile| file.path().file_name().unwrap_or_default().to_string_lossy().into_owned();
        let replace = files.iter().zip(&written).map(|((name, _), file)| (name.clone(), base(file))).collect();
        let record = Record { format: FORMAT.to_owned(), version: VERSION, replace, remove };

        let path = self.folder.join(RECORD);
        let text = serde_json::to_vec(&record).map_err(|e| Error::io(&path, e))?;
        let file = write(RECORD, &text)?;
        self.cancel.check()?;
        let committed = disk::sync_folder(self.folder).and_then(|()| disk::rename(file.path(), &path));
        if let Err(error) = committed {
            // Some file systems rename and report an error all the same. The record goes before what it speaks of.
            drop(std::fs::remove_file(&path));
            return Err(Error::io(&path, error));
        }
        for mut file in written.into_iter().chain([file]) {
            file.disable_cleanup(true);
        }
        record.finish(self.folder)
    }
}

/// What the temporary files of a save are for.
#[derive(Debug, PartialEq, Serialize, Deserialize)]
struct Record {
    format: String,
    version: u64,
    /// The temporary file of every new one.
    replace: BTreeMap<String, String>,
    /// Files that are not needed any more.
    remove: BTreeSet<String>,
}

impl Record {
    fn read(folder: &Path) -> Result<Option<Self>> {
        let path = folder.join(RECORD);
        let Some(bytes) = if_there(read_file(&path, MAX_RECORD_BYTES))? else { return Ok(None) };
        let invalid = |reason: String| Error::invalid(path.display().to_string(), reason);
        let record: Self = serde_json::from_slice(&bytes).map_err(|e| invalid(e.to_string()))?;
        if (record.format.as_str(), record.version) != (FORMAT, VERSION) {
            let Self { format, version, .. } = record;
            let reason = format!("format {format:?}, version {version}; read is {FORMAT:?}, version {VERSION}");
            return Err(invalid(reason));
        }
        // What came with the folder from somewhere else reaches nothing outside of it.
        let (files, temporaries) = (record.replace.keys().chain(&record.remove), record.replace.values());
        match files.chain(temporaries.clone()).find(|name| !is_plain(name)) {
            Some(name) => Err(invalid(format!("expected names of files in the folder, got {name:?}"))),
            None => match temporaries.clone().find(|name| !is_temporary(name)) {
                Some(name) => Err(invalid(format!("expected names of temporary files, got {name:?}"))),
                None => Ok(Some(record)),
            },
        }
    }

    /// Puts the files in their places, as far as they are not there yet.
    fn finish(&self, folder: &Path) -> Result<()> {
        let failed = |file: &str, error: io::Error| {
            let reason =
                format!("{error}; the new files are written, and the next save or load here puts them in place");
            Error::io(&folder.join(file), io::Error::new(error.kind(), reason))
        };
        for (file, temporary) in &self.replace {
            match disk::rename(&folder.join(temporary), &folder.join(file)) {
                Err(error) if error.kind() != ErrorKind::NotFound => return Err(failed(file, error)),
                _ => {}
            }
        }
        for file in &self.remove {
            match disk::remove(&folder.join(file)) {
                Err(error) if error.kind() != ErrorKind::NotFound => {
                    tracing::warn!("{}: not removed: {error}", folder.join(file).display());
                }
                _ => {}
            }
        }
        // The record goes when what it says has reached the disk.
        disk::sync_folder(folder)
            .and_then(|()| disk::remove(&folder.join(RECORD)))
            .and_then(|()| disk::sync_folder(folder))
            .map_err(|error| failed(RECORD, error))
    }
}

/// Finishes what dead saves began and, where nobody else is at work, clears away what they left.
fn recover(folder: &Path, alone: Option<&Lock>) -> Result<()> {
    if let Some(record) = Record::read(folder)? {
        record.finish(folder)?;
    }
    if alone.is_some() {
        for name in leftovers(folder).filter(|name| is_temporary(name)) {
            if let Err(error) = disk::remove(&folder.join(&name)) {
                tracing::warn!("{}: not removed: {error}", folder.join(name).display());
            }
        }
    }
    Ok(())
}

/// The files of saves that are at work or dead; none where the folder cannot be listed.
fn leftovers(folder: &Path) -> impl Iterator<Item = String> {
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
    entries.filter_map(|entry| entry.file_name().into_string().ok()).filter(|name| name == RECORD || is_temporary(name))
}

fn is_temporary(name: &str) -> bool {
    name.len() > TEMPORARY.0.len() + TEMPORARY.1.len() && name.starts_with(TEMPORARY.0) && name.ends_with(TEMPORARY.1)
}

/// Whether a name is that of something in the folder itself.
pub(crate) fn is_plain(name: &str) -> bool {
    let mut components = Path::new(name).components();
    matches!((components.next(), components.next()), (Some(Component::Normal(only)), None) if only == name)
}

/// The files of a folder as one save left them.
pub(crate) struct Files<'a> {
    folder: &'a Path,
    cancel: &'a CancelToken,
    record: Option<Record>,
    /// The file that describes the others, if it is there. Every save writes it anew.
    pub description: Option<Vec<u8>>,
}

impl<'a> Files<'a> {
    fn open(folder: &'a Path, description: &str, max: u64, cancel: &'a CancelToken) -> Result<Self> {
        let mut files = Self { folder, cancel, record: Record::read(folder)?, description: None };
        files.description = match files.read(description, max) {
            Err(Error::Io { source, .. }) if source.kind() == ErrorKind::NotFound => None,
            bytes => Some(bytes?),
        };
        Ok(files)
    }

    /// The bytes of a file, at most `max`; a path that leaves the folder is read as it is.
    pub fn read(&self, file: &str, max: u64) -> Result<Vec<u8>> {
        let temporary = self.record.as_ref().and_then(|record| record.replace.get(file));
        if let Some(temporary) = temporary
            && let Some(bytes) = if_there(read_file_unless(&self.folder.join(temporary), max, self.cancel))?
        {
            return Ok(bytes);
        }
        read_file_unless(&self.folder.join(file), max, self.cancel)
    }

    fn is_like(&self, other: &Self) -> bool {
        self.record == other.record && self.description == other.description
    }
}

/// What `read` makes of the files of one save: where a save replaces them meanwhile, it begins again. `description` is read first, at most `max` bytes of it.
///
/// What dead saves began is finished, where this process may write. The reading ends once `cancel` is cancelled.
pub(crate) fn read_whole<T>(
    folder: &Path,
    description: &str,
    max: u64,
    cancel: &CancelToken,
    read: impl Fn(&Files<'_>) -> Result<T>,
) -> Result<T> {
    if leftovers(folder).next().is_some()
        && let Ok(alone) = Lock::now(folder)
        && let Err(error) = recover(folder, Some(&alone))
    {
        tracing::debug!("{error}");
    }
    for _ in 1..READINGS {
        let files = Files::open(folder, description, max, cancel)?;
        let result = read(&files);
        cancel.check()?;
        let after = Files::open(folder, description, max, cancel)?;
        // A file may have been renamed between two attempts to open it, while its record was there.
        if files.is_like(&after) && (result.is_ok() || files.record.is_none()) {
            return result;
        }
        std::thread::sleep(PAUSE);
    }
    read(&Files::open(folder, description, max, cancel)?)
}

fn if_there(read: Result<Vec<u8>>) -> Result<Option<Vec<u8>>> {
    match read {
        Err(Error::Io { source, .. }) if source.kind() == ErrorKind::NotFound => Ok(None),
        bytes => bytes.map(Some),
    }
}

fn temporary_in(folder: &Path) -> io::Result<NamedTempFile> {
    disk::step()?;
    let mut builder = tempfile::Builder::new();
    builder.prefix(TEMPORARY.0).suffix(TEMPORARY.1);
    // What any new file would get: the process's umask takes its part off.
    #[cfg(unix)]
    builder.permissions(std::os::unix::fs::PermissionsExt::from_mode(0o666));
    builder.tempfile_in(folder)
}

/// With whom a lock is shared.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Share {
    Nobody,
    Others,
}

/// The lock on a folder.
struct Lock(File);

impl Lock {
    /// The lock as soon as it is to be had; `None` where there are no locks on folders.
    fn wait(folder: &Path, share: Share, cancel: &CancelToken) -> Result<Option<Self>> {
        let Ok(file) = File::open(folder) else { return Ok(None) };
        let since = Instant::now();
        loop {
            cancel.check()?;
            let locked = if share == Share::Nobody { file.try_lock() } else { file.try_lock_shared() };
            match locked {
                Ok(()) => return Ok(Some(Self(file))),
                Err(TryLockError::Error(_)) => return Ok(None),
                Err(TryLockError::WouldBlock) if since.elapsed() < PATIENCE => std::thread::sleep(PAUSE),
                Err(TryLockError::WouldBlock) => {
                    let reason = format!(
                        "another process has been saving here for {} s; end it or save elsewhere",
                        PATIENCE.as_secs()
                    );
                    return Err(Error::io(folder, io::Error::new(ErrorKind::TimedOut, reason)));
                }
            }
        }
    }

    /// The lock, shared with nobody, if it is to be had at once.
    fn now(folder: &Path) -> io::Result<Self> {
        let file = File::open(folder)?;
        file.try_lock()?;
        Ok(Self(file))
    }
}

impl Drop for Lock {
    fn drop(&mut self) {
        // Closing would not do where a child process has inherited the file.
        drop(self.0.unlock());
    }
}

/// What saves ask of the disk; tests let it fail.
mod disk {
    use std::fs::File;
    use std::io::{self, Write};
    use std::path::Path;

    pub fn step() -> io::Result<()> {
        #[cfg(test)]
        super::failing::step()?;
        Ok(())
    }

    pub fn write(file: &mut impl Write, bytes: &[u8]) -> io::Result<()> {
        step()?;
        file.write_all(bytes)
    }

    pub fn sync(file: &File) -> io::Result<()> {
        step()?;
        file.sync_all()
    }

    pub fn rename(from: &Path, to: &Path) -> io::Result<()> {
        step()?;
        std::fs::rename(from, to)
    }

    pub fn remove(path: &Path) -> io::Result<()> {
        step()?;
        std::fs::remove_file(path)
    }

    /// Names reach the disk. Not every system and file system can be asked for it.
    pub fn sync_folder(folder: &Path) -> io::Result<()> {
        step()?;
        if cfg!(not(unix)) {
            return Ok(());
        }
        let folder = if folder.as_os_str().is_empty() { Path::new(".") } else { folder };
        match File::open(folder)?.sync_all() {
            Err(error) if matches!(error.kind(), io::ErrorKind::InvalidInput | io::ErrorKind::Unsupported) => Ok(()),
            synced => synced,
        }
    }
}

/// A disk that fails.
#[cfg(test)]
pub(crate) mod failing {
    use std::cell::Cell;
    use std::io;

    thread_local! {
        /// Steps until one fails, and whether all after it do too.
        static LEFT: Cell<Option<(usize, bool)>> = const { Cell::new(None) };
    }

    pub fn step() -> io::Result<()> {
        match LEFT.get() {
            None => Ok(()),
            Some((0, stays)) => {
                LEFT.set(stays.then_some((0, true)));
                Err(io::Error::other("the disk fails"))
            }
            Some((left, stays)) => {
                LEFT.set(Some((left - 1, stays)));
                Ok(())
            }
        }
    }

    /// Runs `work` on a disk whose step `at`, counted from 0, fails, and where it `stays` broken all later ones. Also whether that step was reached.
    pub fn at<T>(at: usize, stays: bool, work: impl FnOnce() -> T) -> (T, bool) {
        LEFT.set(Some((at, stays)));
        let result = work();
        let left = LEFT.replace(None);
        (result, left.is_none_or(|(left, _)| left == 0 && stays))
    }
}

#[cfg(test)]
mod tests {
    use std::fs;

    use tempfile::TempDir;

    use super::*;

    fn save(folder: &Path, files: &[(&str, &str)], remove: &[&str]) -> Result<()> {
        let files: Vec<_> = files.iter().map(|&(name, text)| (name.to_owned(), text.as_bytes().to_vec())).collect();
        Saving::begin(folder, &CancelToken::new())?
            .replace(&files, remove.iter().map(|&name| name.to_owned()).collect())
    }

    /// Names and contents of a folder.
    fn content(folder: &Path) -> Vec<(String, String)> {
        let mut content: Vec<_> = fs::read_dir(folder)
            .unwrap()
            .map(|entry| entry.unwrap())
            .map(|entry| (entry.file_name().into_string().unwrap(), fs::read_to_string(entry.path()).unwrap()))
            .collect();
        content.sort();
        content
    }

    fn named(files: &[(&str, &str)]) -> Vec<(String, String)> {
        files.iter().map(|&(name, text)| (name.to_owned(), text.to_owned())).collect()
    }

    const OLD: [(&str, &str); 3] = [("a", "old a"), ("about", "old"), ("b", "old b")];
    const NEW: [(&str, &str); 3] = [("a", "new a"), ("about", "new"), ("c", "new c")];

    /// What a load finds: all of `about`, `a`, `b` and `c` that is there.
    fn loaded(folder: &Path) -> Vec<(String, String)> {
        let read = |files: &Files<'_>| {
            let names = ["a", "about", "b", "c"].into_iter();
            Ok(names
                .filter_map(|name| Some((name.to_owned(), String::from_utf8(files.read(name, 99).ok()?).unwrap())))
                .collect())
        };
        read_whole(folder, "about", 99, &CancelToken::new(), read).unwrap()
    }

    #[test]
    fn a_failing_disk_leaves_all_old_or_all_new_files() {
        let (mut old, mut new) = (0, 0);
        for stays in [false, true] {
            for at in 0.. {
                let dir = TempDir::new().unwrap();
                save(dir.path(), &OLD, &[]).unwrap();
                let (result, reached) = failing::at(at, stays, || save(dir.path(), &NEW, &["b"]));
                if !reached {
                    result.unwrap();
                    // Four files written, four renamed, one removed, and what comes with it.
                    assert!(at > 20, "{at}");
                    break;
                }
                // A load that may not write takes what the record says.
                let kept = |mut found: Vec<(String, String)>| {
                    found.retain(|(name, _)| name != "b");
                    found
                };
                let (frozen, _) = failing::at(0, true, || kept(loaded(dir.path())));
                let is_old = content(dir.path()).contains(&("about".to_owned(), "old".to_owned()))
                    && !dir.path().join(RECORD).exists();
                assert_eq!(frozen, kept(named(if is_old { &OLD } else { &NEW })), "step {at}");
                // One that may write leaves the folder clean, but for what was to be removed and could not be.
                assert_eq!(kept(loaded(dir.path())), kept(named(if is_old { &OLD } else { &NEW })), "step {at}");
                assert_eq!(kept(content(dir.path())), kept(named(if is_old { &OLD } else { &NEW })), "step {at}");
                // Only what is tidied up at the end may fail without an error.
                assert!(result.is_err() || !is_old, "step {at}");
                let message = result.err().map(|error| error.to_string()).unwrap_or_default();
                assert!(is_old != message.contains("puts them in place") || message.is_empty(), "{message}");
                if is_old { old += 1 } else { new += 1 }
            }
        }
        assert!(old > 10 && new > 10, "{old} {new}");
    }

    #[test]
    fn a_cancelled_save_leaves_nothing_or_is_carried_out() {
        let given: Vec<_> = NEW.iter().map(|&(name, text)| (name.to_owned(), text.as_bytes().to_vec())).collect();
        let run = |folder: &Path, last: usize| {
            let cancel = CancelToken::at_look(last);
            let saved = Saving::begin(folder, &cancel).and_then(|saving| {
                assert!(folder.exists());
                saving.replace(&given, BTreeSet::from(["b".to_owned()]))
            });
            (saved, cancel.looks())
        };
        let dir = TempDir::new().unwrap();
        let looks = run(&dir.path().join("count"), usize::MAX).1;
        // At the beginning, for the lock, before each of three files and the record, and before the record takes its place.
        assert_eq!(looks, 7);
        for last in 1..=looks {
            let (old, new) = (dir.path().join("old"), dir.path().join("new").join("er"));
            save(&old, &OLD, &[]).unwrap();
            for folder in [&old, &new] {
                let (saved, _) = run(folder, last);
                assert!(matches!(saved, Err(Error::Cancelled)), "look {last}: {saved:?}");
            }
            assert_eq!(content(&old), named(&OLD), "look {last}");
            assert!(!new.parent().unwrap().exists(), "look {last}");
        }
        let (saved, _) = run(&dir.path().join("old"), looks + 1);
        saved.unwrap();
        assert_eq!(content(&dir.path().join("old")), named(&NEW));
    }

    #[test]
    fn a_save_finishes_what_a_dead_one_began() {
        let dir = TempDir::new().unwrap();
        save(dir.path(), &OLD, &[]).unwrap();
        for at in 0..40 {
            drop(failing::at(at, true, || save(dir.path(), &NEW, &["b"])));
            save(dir.path(), &OLD, &["c"]).unwrap();
            assert_eq!(content(dir.path()), named(&OLD), "step {at}");
        }
    }

    #[test]
    fn temporary_files_are_cleared_unless_they_live() {
        let dir = TempDir::new().unwrap();
        save(dir.path(), &OLD, &[]).unwrap();
        let dead = dir.path().join(".svbrdf-gcn-dead00.tmp");
        fs::write(&dead, "half").unwrap();
        fs::write(dir.path().join(".svbrdf-gcn.tmp"), "not ours").unwrap();
        let alive = Temporary::beside(&dir.path().join("picture")).unwrap();
        assert_eq!(loaded(dir.path()), named(&OLD));
        assert!(dead.exists() && alive.file.path().exists());
        alive.persist(&dir.path().join("picture")).unwrap();
        assert_eq!(loaded(dir.path()), named(&OLD));
        assert!(!dead.exists() && dir.path().join("picture").exists() && dir.path().join(".svbrdf-gcn.tmp").exists());
        write_file(&dir.path().join("picture"), b"again").unwrap();
        assert_eq!(fs::read(dir.path().join("picture")).unwrap(), b"again");
        let (failed, _) = failing::at(2, false, || write_file(&dir.path().join("picture"), b"lost"));
        assert!(failed.is_err());
        assert_eq!(fs::read(dir.path().join("picture")).unwrap(), b"again");
        assert_eq!(leftovers(dir.path()).count(), 0);
    }

    #[test]
    fn saves_wait_for_each_other() {
        let dir = TempDir::new().unwrap();
        std::thread::scope(|scope| {
            for writer in 0..4 {
                let folder = dir.path();
                scope.spawn(move || {
                    for round in 0..10 {
                        let text = format!("{writer} {round}");
                        save(folder, &[("a", &text), ("b", &text), ("about", &text)], &[]).unwrap();
                        let found = loaded(folder);
                        assert_eq!(found.len(), 3);
                        assert!(found.iter().all(|(_, text)| *text == found[0].1), "{found:?}");
                    }
                });
            }
        });
        assert_eq!(content(dir.path()).len(), 3);
    }

    #[test]
    fn a_record_reaches_nothing_outside_of_its_folder() {
        let dir = TempDir::new().unwrap();
        let folder = dir.path().join("in");
        fs::create_dir(&folder).unwrap();
        fs::write(dir.path().join("out"), "mine").unwrap();
        for (replace, remove) in [
            (r#"{}"#, r#"["../out"]"#),
            (r#"{"../out": ".svbrdf-gcn-a.tmp"}"#, "[]"),
            (r#"{"a": "../out"}"#, "[]"),
            (r#"{"a": "b"}"#, "[]"),
        ] {
            let text =
                format!(r#"{{"format": "svbrdf-gcn save", "version": 1, "replace": {replace}, "remove": {remove}}}"#);
            fs::write(folder.join(RECORD), text).unwrap();
            let message = save(&folder, &NEW, &[]).unwrap_err().to_string();
            assert!(message.contains(RECORD) && message.contains("expected names"), "{message}");
            assert!(read_whole(&folder, "about", 99, &CancelToken::new(), |_| Ok(())).is_err());
            assert_eq!(fs::read_to_string(dir.path().join("out")).unwrap(), "mine");
        }
    }
}
