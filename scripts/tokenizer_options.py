from uniforce_vtla.commands.tokenizer_options import main

raise SystemExit(main())
