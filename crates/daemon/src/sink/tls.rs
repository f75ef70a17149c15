//! Encrypted connections of sinks: whom they trust, and who they say they are.

use std::path::Path;
use std::sync::Arc;

use rustls::pki_types::pem::PemObject;
use rustls::pki_types::{CertificateDer, PrivateKeyDer};
use rustls::{ClientConfig, RootCertStore};
use seepd_settings::side_file;

use crate::failure::{Code, Failure};

/// A client that trusts the certificates of a file, with its own certificate and key where it has them (PEM).
///
/// # Errors
/// [`Failure`] where one of the files cannot be read.
pub(super) fn client(ca_file: &Path, own: Option<(&Path, &Path)>) -> Result<Arc<ClientConfig>, Failure> {
    let bad =
        |path: &Path, what: String| Failure::new(Code::Configuration, format!("{}: {what}", path.display()));
    let mut roots = RootCertStore::empty();
    roots.add_parsable_certificates(certificates(ca_file)?);
    if roots.is_empty() {
        return Err(bad(ca_file, "the file has no certificate that can be trusted".into()));
    }
    let provider = Arc::new(rustls::crypto::ring::default_provider());
    let builder = ClientConfig::builder_with_provider(provider)
        .with_safe_default_protocol_versions()
        .map_err(|error| Failure::new(Code::Internal, error.to_string()))?
        .with_root_certificates(roots);
    let config = match own {
        Some((certificate, key)) => {
            let pem = side_file::read(key).map_err(|error| Failure::reading(key, &error))?;
            let private = PrivateKeyDer::from_pem_slice(&pem).map_err(|error| bad(key, error.to_string()))?;
            builder
                .with_client_auth_cert(certificates(certificate)?, private)
                .map_err(|error| bad(certificate, error.to_string()))?
        }
        None => builder.with_no_client_auth(),
    };
    Ok(Arc::new(config))
}

fn certificates(path: &Path) -> Result<Vec<CertificateDer<'static>>, Failure> {
    let pem = side_file::read(path).map_err(|error| Failure::reading(path, &error))?;
    CertificateDer::pem_slice_iter(&pem).collect::<Result<Vec<_>, _>>().map_err(|error| {
        Failure::configuration(path, format!("this is not a PEM file of certificates: {error}"))
    })
}
