#!/bin/sh
# apt_install.sh WHAT OTHERWISE PACKAGE...: install Debian packages. Asks no question.
# Exit code 2 where that cannot be done here; then OTHERWISE says what it means.
set -eu
what="$1" otherwise="$2"
shift 2

if [ "$(id -u)" = 0 ]; then sudo=""
elif sudo -n true 2>/dev/null; then sudo="sudo -n"
else
    echo "No $what found: $otherwise; 'sudo apt-get install $*' brings it." >&2
    exit 2
fi
if ! command -v apt-get >/dev/null; then
    echo "No $what and no apt-get here: $otherwise." >&2
    exit 2
fi
echo "Installing $what: $*"
$sudo apt-get -qq update
$sudo env DEBIAN_FRONTEND=noninteractive apt-get -qq -y install --no-install-recommends "$@" >/dev/null
