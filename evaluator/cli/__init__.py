"""The command line: parse, call one library function, print. stdout is the result, stderr the progress."""
