"""One module per stage: a case in, files and a result out; its parts are in the package named after it."""
