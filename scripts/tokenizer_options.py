from uniforce_commands.tokenizer_options import main

raise SystemExit(main())
