"""Methods that run as a program of their own, in any language (docs/wire-protocol.md): the harness's side."""
