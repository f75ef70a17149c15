#!/bin/sh
# Unpacks seepd for this machine: sh install.sh [--gateway] [FOLDER]. The archive and SHA256SUMS lie beside this file; what is unpacked has the
# sum that stands there, or nothing is. FOLDER is ~/.local unless another is named. For a service under systemd take the .deb.
set -eu
version=@VERSION@
kind=
[ "${1:-}" = --gateway ] && { kind=gateway-; shift; }
folder=${1:-$HOME/.local}
here=$(cd "$(dirname "$0")" && pwd)

case "$(uname -s)-$(uname -m)" in
  Linux-x86_64) name=seepd-$version-${kind}linux-x86_64 ;;
  *) echo "there is no archive for $(uname -s) on $(uname -m); build it: cargo build --release -p seepd" >&2; exit 69 ;;
esac
archive=$here/$name.tar.gz
[ -f "$archive" ] || { echo "$archive is not there" >&2; exit 66; }
expected=$(sed -n "s/^\([0-9a-f]*\)  $name\.tar\.gz\$/\1/p" "$here/SHA256SUMS")
found=$(sha256sum "$archive" | cut -d' ' -f1)
if [ -z "$expected" ] || [ "$expected" != "$found" ]; then
  echo "$archive has not the sum that stands in SHA256SUMS: fetch both again" >&2
  exit 65
fi

mkdir -p "$folder/bin" "$folder/share/doc" "$folder/share/man/man1"
unpacked=$(mktemp -d)
trap 'rm -rf "$unpacked"' EXIT
tar -xzf "$archive" -C "$unpacked"
install -m 755 "$unpacked/$name/seepd" "$folder/bin/seepd"
install -m 644 "$unpacked/$name"/man/*.1 "$folder/share/man/man1/"
rm -rf "$folder/share/doc/seepd"
mkdir -p "$folder/share/doc/seepd"
for item in README.md CHANGELOG.md LICENSE-MIT LICENSE-APACHE THIRD-PARTY.txt seepd.cdx.json seepd.toml docs completions; do
  cp -r "$unpacked/$name/$item" "$folder/share/doc/seepd/"
done
echo "$("$folder/bin/seepd" --version) is in $folder/bin; documentation and shell completions are in $folder/share/doc/seepd"
