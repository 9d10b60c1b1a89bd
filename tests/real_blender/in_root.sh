#!/bin/bash
# in_root.sh ROOT COMMAND ... : the command with ROOT as its file system, in a mount namespace of its own, so that nothing
# stays mounted whatever happens. IRIS_BIND has what else is seen inside: FOLDER=PLACE, separated by ":";
# IRIS_SMALL_DISK is where a disk of 200 kB is mounted, for tests that fill it.
exec unshare --mount --propagation private bash -c '
  root=$1; shift
  mount -t proc proc "$root/proc" && mount --rbind /sys "$root/sys" && mount --rbind /dev "$root/dev" || exit 125
  IFS=:
  for pair in $IRIS_BIND; do
    place=$root${pair#*=}
    mkdir -p "$place" && mount --rbind "${pair%%=*}" "$place" || exit 125
  done
  unset IFS
  [ -n "$IRIS_SMALL_DISK" ] && mkdir -p "$root$IRIS_SMALL_DISK" && mount -t tmpfs -o size=200k tmpfs "$root$IRIS_SMALL_DISK" || exit 125
  exec chroot "$root" /usr/bin/env PATH=/usr/sbin:/usr/bin:/sbin:/bin "$@"' in_root "$@"
