//! The files of a folder of S3, or those that fit a pattern.

use std::io;
use std::path::PathBuf;
use std::time::Duration;

use futures_util::TryStreamExt;
use glob::{MatchOptions, Pattern};

use super::WILDCARDS;
use super::store::Server;

/// A `*` stays within a folder; `**` goes into those below.
const WITHIN_A_FOLDER: MatchOptions = MatchOptions {
    case_sensitive: true,
    require_literal_separator: true,
    require_literal_leading_dot: false,
};

/// Their addresses, in no order. Of the bucket, the folder before the first wildcard is listed.
///
/// # Errors
/// It is no pattern, or the server cannot be asked.
pub(super) fn listed(address: &str, silence: Duration) -> io::Result<Vec<PathBuf>> {
    let first = address.find(WILDCARDS).unwrap_or(address.len());
    let (folder, pattern) = address.split_at(address[..first].rfind('/').map_or(first, |slash| slash + 1));
    let pattern = if pattern.is_empty() { "*" } else { pattern };
    let fits = Pattern::new(pattern)
        .map_err(|error| io::Error::new(io::ErrorKind::InvalidInput, format!("as a pattern: {error}")))?;
    let (server, place) = Server::of(folder, silence)?;
    let in_folders_below = pattern.contains('/') || pattern.contains("**");
    let objects = server.wait(async |store| {
        if in_folders_below {
            return store.list(Some(&place)).try_collect().await;
        }
        Ok(store.list_with_delimiter(Some(&place)).await?.objects)
    })?;
    let name_in_folder = |location: &str| {
        let rest = location.strip_prefix(place.as_ref())?;
        Some(rest.trim_start_matches('/').to_owned())
    };
    let names = objects.iter().filter_map(|object| name_in_folder(object.location.as_ref()));
    let fitting = names.filter(|name| fits.matches_with(name, WITHIN_A_FOLDER));
    Ok(fitting.map(|name| PathBuf::from(format!("{folder}{name}"))).collect())
}
