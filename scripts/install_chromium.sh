#!/bin/sh
# Install Chromium, in which the tests open reports, where there is none.
set -eu

if command -v chromium >/dev/null || command -v google-chrome >/dev/null; then exit 0; fi
sh "$(dirname "$0")/apt_install.sh" Chromium "the tests that open reports are skipped" chromium || {
    status=$?
    [ "$status" = 2 ] || exit "$status"     # those tests are skipped: no reason to stop
}
