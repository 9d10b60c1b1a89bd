#!/bin/bash
# set_up.sh SUITE ROOT : a Debian of that suite with its Blender, an X server without a screen, a mouse and software
# OpenGL, from the mirror that this machine's apt already uses. Does nothing when ROOT is complete. As root.
# Exit status 75: this machine cannot have one, and the last line says why.
set -euo pipefail
suite=$1 root=$2
cannot() { echo "$*"; exit 75; }

[ -e "$root/.ready" ] && exit 0
[ "$(id -u)" = 0 ] || cannot "needs root, for chroot and mount"
command -v apt-get >/dev/null || cannot "needs a Debian or one of its relatives: there is no apt-get"
unshare --mount true 2>/dev/null || cannot "mount namespaces are not allowed here"
codename=$(. /etc/os-release && echo "${VERSION_CODENAME:-}")
mirror=$(apt-get indextargets --format '$(SITE)' "Created-By: Packages" "Codename: $codename" | sed -n 1p)
[ -n "$mirror" ] || cannot "apt has no package source to take Blender from"
keyring=/usr/share/keyrings/debian-archive-keyring.gpg
[ -e "$keyring" ] || cannot "the key ring of Debian's archive is missing ($keyring)"
probe=$(mktemp -d)
trap 'rm -rf "$probe"' EXIT
/usr/lib/apt/apt-helper download-file "$mirror/dists/$suite/InRelease" "$probe/InRelease" >/dev/null 2>&1 ||
  cannot "the package mirror does not answer for suite $suite"
if ! command -v mmdebstrap >/dev/null; then
  { apt-get -qq update && DEBIAN_FRONTEND=noninteractive apt-get -qq install -y --no-install-recommends mmdebstrap
  } >/dev/null 2>&1 || cannot "mmdebstrap is not installed and cannot be"
fi

if grep -q " $root/" /proc/mounts; then echo "something is mounted under $root"; exit 1; fi
rm -rf --one-file-system "$root"
mkdir -p "$(dirname "$root")"
packages=(
  blender python3-numpy python3-requests python3-zstandard
  python3-attr python3-cattr python3-fastjsonschema # imported by Blender 5's extension manager, not declared by it
  ca-certificates xvfb libgl1-mesa-dri libgl1 libegl1 xdotool
)
mmdebstrap --quiet --variant=apt --mode=root --keyring="$keyring" \
  --aptopt='Apt::Install-Recommends "false"' --aptopt='Acquire::Languages "none"' --aptopt='Acquire::Retries "5"' \
  --aptopt='Acquire::Check-Valid-Until "false"' --dpkgopt=force-unsafe-io \
  --dpkgopt='path-exclude=/usr/share/doc/*' --dpkgopt='path-exclude=/usr/share/man/*' \
  --dpkgopt='path-exclude=/usr/share/locale/*' --dpkgopt='path-exclude=/usr/share/info/*' \
  --include="$(IFS=,; echo "${packages[*]}")" "$suite" "$root" "$mirror"
ln -sfn /proc/self/mounts "$root/etc/mtab" # without it Blender warns about the list of file systems
touch "$root/.ready"
