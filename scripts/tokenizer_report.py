from uniforce_vtla.commands.tokenizer_report import main

raise SystemExit(main())
