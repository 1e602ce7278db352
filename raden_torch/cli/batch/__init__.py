"""Many runs of `raden`, one after another, with one report: photograph sets, a queue of scans."""
