#!/usr/bin/env bash
# The runtimes that pip cannot put beside us: Node.js packages, Chromium, LLVM for Mitsuba, and an old
# ONNX Runtime in a Python environment of its own. What cannot be had here is said and left out; its tests skip.
set -uo pipefail
cd "$(dirname "$0")"

if command -v npm >/dev/null; then
	npm install --ignore-scripts --no-package-lock --no-audit --no-fund --silent ||
		echo "runtimes: npm could not install; onnxruntime-node and -web are left out"
else
	echo "runtimes: no npm; onnxruntime-node and -web are left out"
fi

if ! command -v chromium >/dev/null && ! command -v google-chrome >/dev/null; then
	if [ "$(id -u)" = 0 ] && command -v apt-get >/dev/null; then
		apt-get update -qq >/dev/null 2>&1
		apt-get install -y -qq --no-install-recommends chromium >/dev/null 2>&1 ||
			echo "runtimes: apt-get could not install chromium; the browser is left out"
	else
		echo "runtimes: no Chromium, and it takes root and apt-get to install it; left out"
	fi
fi

# Mitsuba's LLVM variants take the newest; 15 and 16 end the process on machines with AVX-512
if ! ldconfig -p 2>/dev/null | grep -q 'libLLVM.*19'; then
	if [ "$(id -u)" = 0 ] && command -v apt-get >/dev/null; then
		apt-get update -qq >/dev/null 2>&1
		apt-get install -y -qq --no-install-recommends libllvm19 >/dev/null 2>&1 ||
			echo "runtimes: apt-get could not install libllvm19; Mitsuba's LLVM variants are left out"
	else
		echo "runtimes: no LLVM 19, and it takes root and apt-get to install it; left out"
	fi
fi

old=onnxruntime-1.18
if [ ! -e "$old/made" ]; then
	for python in python3.11 python3.10 python3.12 ""; do
		[ -n "$python" ] && "$python" -c "" 2>/dev/null && break
	done
	if [ -n "$python" ] && "$python" -m venv "$old" &&
		"$old/bin/python" -m pip install --quiet --disable-pip-version-check \
			onnxruntime==1.18.1 'numpy<2'; then
		touch "$old/made"
	else
		echo "runtimes: ONNX Runtime 1.18 wants Python 3.10 to 3.12; left out"
	fi
fi
touch made
